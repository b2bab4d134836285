// What became of the drive of this page that ended last: in words, and as a file.

import { api } from "../pages/calls.js";
import { byTestId, make, part, setText } from "../pages/page.js";
import { summary as texts } from "../texts/panels.js";
import { driveRows, headline, moved } from "./driveWords.js";
import { recordOf } from "./driveRecord.js";

const fetchDrives = (robot, fence) => api.get("/api/v1/drives", { robot, fence });
const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export class Summary {
  // `root` is the panel, a <details>.
  constructor(root, { robot }) {
    Object.assign(this, { root, robot });
    this.driving = false;
    this.round = 0;
    part(root, "summary-save").addEventListener("click", () => this.save());
    part(root, "summary-close").addEventListener("click", () => (root.hidden = true));
  }

  // Who drives again needs the room.
  use({ live, driving }) {
    const drives = live && driving;
    if (drives && !this.driving) this.fold();
    this.driving = drives;
  }

  fold() {
    this.root.open = false;
    if (this.scrolledTo) byTestId(document, "controls").scrollIntoView({ block: "nearest" });
    this.scrolledTo = false;
  }

  async driveEnded({ fence }) {
    const round = ++this.round;
    this.drive = null;
    this.show(texts.asking, []);
    const found = await recordOf({ robot: this.robot, fence, fetchDrives, wait });
    if (round !== this.round) return;
    if (typeof found === "string") return this.show(texts[found], []);
    this.drive = found;
    if (!moved(found)) return void (this.root.hidden = true);
    this.show(headline(found), driveRows(found));
    if (this.driving) return;
    this.root.open = true;
    // Who lost the control, or the link, may be about to drive on: the stick stays where it is.
    this.scrolledTo = found.end_code === "client_left";
    if (this.scrolledTo) this.root.scrollIntoView({ block: "nearest" });
  }

  // What comes while somebody drives must not move the stick, nor a button below.
  show(words, rows) {
    if (this.driving && this.root.hidden) return;
    this.root.hidden = false;
    setText(part(this.root, "summary-headline"), words);
    part(this.root, "summary-save").hidden = !this.drive;
    const pairs = rows.map(({ name, label, text }) =>
      make("div", {}, make("dt", {}, label), make("dd", { "data-testid": `summary-${name}` }, text)),
    );
    part(this.root, "summary-rows").replaceChildren(...pairs);
  }

  save() {
    const text = `${JSON.stringify(this.drive, null, 2)}\n`;
    const url = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    const link = make("a", { href: url, download: `robotether-${this.robot}-drive-${this.drive.id}.json` });
    link.click();
    setTimeout(() => URL.revokeObjectURL(url), 10_000);
  }
}
