// Shows pictures in an <img> or on a <canvas> of the page, one at a time.

// Gives the function that shows {jpeg} and settles when it is to be seen; it rejects for what is no picture.
export function showOn(element) {
  if (element.localName === "canvas") return ({ jpeg }) => draw(element, jpeg);
  if (element.localName === "img") return imageShower(element);
  throw new TypeError(`cannot show video in <${element.localName}>: give an <img> or a <canvas>`);
}

const blobOf = (jpeg) => new Blob([jpeg], { type: "image/jpeg" });

async function draw(canvas, jpeg) {
  const bitmap = await createImageBitmap(blobOf(jpeg));
  if (canvas.width !== bitmap.width) canvas.width = bitmap.width;
  if (canvas.height !== bitmap.height) canvas.height = bitmap.height;
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  bitmap.close();
}

function imageShower(img) {
  let shown = null;
  return async ({ jpeg }) => {
    const before = shown;
    shown = URL.createObjectURL(blobOf(jpeg));
    try {
      await load(img, shown);
    } finally {
      if (before) URL.revokeObjectURL(before);
    }
  };
}

function load(img, url) {
  return new Promise((resolve, reject) => {
    img.onload = resolve;
    img.onerror = () => reject(new Error("cannot show a picture: it is no JPEG"));
    img.src = url;
  });
}
