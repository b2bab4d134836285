// The picture of the drive page: which camera, at which quality, and what is said when there is none.

import { byTestId, part, setText } from "./page.js";
import { Picture } from "./picture.js";
import { Video, streamUrl } from "./video.js";
import { picture as texts } from "./texts.js";

const USUAL_TOPIC = "/camera/image_raw";

export class View {
  constructor(root, { robot, settings }) {
    this.element = byTestId(root, "view");
    this.robot = robot;
    this.settings = settings;
    this.camera = part(this.element, "camera");
    this.quality = part(this.element, "quality");
    this.img = byTestId(this.element, "video");
    const picture = new Picture(this.img);
    this.video = new Video({
      onFrame: (jpeg) => picture.show(jpeg),
      onStatus: (status) => this.show(status),
    });
    this.listen();
  }

  start() {
    this.offer([this.settings.camera_topic || USUAL_TOPIC]);
    this.play();
  }

  // `cameras` are the image topics that the robot has; none found changes nothing.
  found(cameras) {
    const configured = this.settings.camera_topic;
    const all = configured && !cameras.includes(configured) ? [configured, ...cameras] : cameras;
    if (all.length === 0) return;
    const playing = this.camera.value;
    this.offer(all);
    if (all.includes(playing)) this.camera.value = playing;
    else this.play();
  }

  retryNow() {
    this.video.retryNow();
  }

  listen() {
    for (const choice of [this.camera, this.quality]) {
      choice.addEventListener("change", () => {
        choice.blur(); // else the drive keys would go on changing it
        this.play();
      });
    }
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.video.pause();
      else this.play();
    });
  }

  offer(topics) {
    this.camera.replaceChildren(...topics.map((topic) => new Option(topic, topic)));
    this.camera.disabled = topics.length < 2;
    if (topics.includes(this.settings.camera_topic)) this.camera.value = this.settings.camera_topic;
  }

  play() {
    const { camera_width: width, camera_height: height } = this.settings;
    const choice = { topic: this.camera.value, quality: this.quality.value, width, height };
    const url = streamUrl(this.robot, choice);
    this.img.dataset.source = url;
    this.video.play(url);
  }

  show({ picture, text }) {
    this.element.dataset.picture = picture;
    this.img.hidden = picture === "none";
    setText(part(this.element, "no-picture"), text || (picture === "none" ? texts.starting : ""));
  }
}
