// Shows JPEG frames in an <img>, always the newest: a frame that comes while one is being decoded
// replaces the one that waits.

export class Picture {
  constructor(img) {
    this.img = img;
    this.waiting = null;
    this.decoding = false;
    this.url = null;
  }

  show(jpeg) {
    this.waiting = jpeg;
    if (!this.decoding) this.paint();
  }

  async paint() {
    this.decoding = true;
    while (this.waiting) {
      const url = URL.createObjectURL(new Blob([this.waiting], { type: "image/jpeg" }));
      this.waiting = null;
      await load(this.img, url);
      if (this.url) URL.revokeObjectURL(this.url);
      this.url = url;
    }
    this.decoding = false;
  }
}

function load(img, url) {
  return new Promise((resolve) => {
    img.onload = resolve;
    img.onerror = resolve; // one broken frame; the next comes soon
    img.src = url;
  });
}
