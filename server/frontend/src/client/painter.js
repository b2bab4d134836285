// Draws JPEGs on a canvas, turned as the camera needs it: on the drive page and, through index.js, on pages of others.
// Decoding happens beside the page's own work, one frame at a time.

export class Painter {
  // `decode(jpeg)` gives a promise of what drawImage takes.
  constructor(canvas, { decode = decodeBeside } = {}) {
    this.canvas = canvas;
    this.decode = decode;
    this.context = canvas.getContext("2d", { alpha: false });
    this.turned = 0;
  }

  // Gives the frame's own size; rejects for what is no image.
  async show(jpeg) {
    const image = await this.decode(jpeg);
    const { width, height } = image;
    this.draw(image);
    image.close();
    return { width, height };
  }

  draw(image) {
    const { width, height } = image;
    const across = this.turned % 180 !== 0;
    fitCanvas(this.canvas, across ? height : width, across ? width : height);
    const { canvas, context } = this;
    context.setTransform(1, 0, 0, 1, canvas.width / 2, canvas.height / 2);
    context.rotate((this.turned * Math.PI) / 180);
    context.drawImage(image, -width / 2, -height / 2);
  }
}

// A canvas that is given its size anew is empty, so only for a new one.
export function fitCanvas(canvas, width, height) {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}

export const imageOf = (jpeg) => new Blob([jpeg], { type: "image/jpeg" });

const decodeBeside = (jpeg) => createImageBitmap(imageOf(jpeg));
