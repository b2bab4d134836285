// Draws frames on a canvas, turned as the camera needs it: on the drive page and, through index.js, on pages of others.

export class Painter {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.turned = 0;
  }

  // `image` as of FrameDecoder; it is closed. Gives the frame's own size.
  show(image) {
    const width = image.displayWidth ?? image.width;
    const height = image.displayHeight ?? image.height;
    try {
      this.draw(image, width, height);
    } finally {
      image.close();
    }
    return { width, height };
  }

  // A canvas whose memory is lost, as after a crash of the graphics driver, draws nothing and reports no error.
  draw(image, width, height) {
    if (this.context.isContextLost?.()) throw new Error("cannot show a frame: the browser has lost the canvas");
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
