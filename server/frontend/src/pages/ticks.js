// What is ticked in a list, for one action on all of it: counted, and kept while the list shows another page or search.
// It is in the page's address, as the server has it (web/admin/selection.py), so that it ends when the list is left.

import { setText } from "../dom/page.js";
import { fleet as texts } from "../texts/fleet.js";

const MOST = 100; // number of names, as the server has it

export class Ticks {
  // `bar`: the element with the count, which names the boxes in data-one. `view` is the window.
  constructor(page, bar, view) {
    this.page = page;
    this.bar = bar;
    this.view = view;
    this.one = bar.dataset.one;
    this.count = bar.querySelector('[data-part="ticks-count"]');
  }

  get boxes() {
    return [...this.page.querySelectorAll(`input[type="checkbox"][name="${this.one}"]`)];
  }

  // The ticked of other pages, which have no boxes here.
  get others() {
    return [...this.page.querySelectorAll(`input[type="hidden"][name="${this.one}"]`)];
  }

  get names() {
    return [...this.others, ...this.boxes.filter((box) => box.checked)].map(({ value }) => value);
  }

  wire() {
    this.page.addEventListener("change", ({ target }) => target.name === this.one && this.changed(target));
    // A search in the list hides rows, and a press shows more.
    for (const name of ["input", "click"]) this.page.addEventListener(name, () => this.show());
    this.view.addEventListener("pageshow", () => this.show());
    this.bar.querySelector('[data-part="ticks-clear"]').addEventListener("click", (event) => {
      event.preventDefault();
      this.clear();
    });
    for (const button of this.page.querySelectorAll('[data-part="ticks-all"]')) {
      button.hidden = false;
      button.addEventListener("click", () => this.tickAll());
    }
    for (const form of this.page.querySelectorAll("form[data-keeps-ticks]")) {
      form.addEventListener("formdata", ({ formData }) => this.names.forEach((name) => formData.append(this.one, name)));
    }
    this.keep();
  }

  changed(box) {
    if (this.names.length > MOST) box.checked = false;
    this.keep();
  }

  // Ticks all that is shown, or none of it if all is ticked.
  tickAll() {
    const boxes = this.boxes.filter((box) => !isHidden(box));
    const ticks = !boxes.every((box) => box.checked);
    for (const box of boxes) box.checked = ticks && (box.checked || this.names.length < MOST);
    this.keep();
  }

  clear() {
    for (const box of this.boxes) box.checked = false;
    for (const other of this.others) other.remove();
    this.keep();
  }

  // In the address of this page and of those that it leads to.
  keep() {
    const { location, history } = this.view;
    history.replaceState(history.state, "", this.withTicks(location.href));
    for (const link of this.page.querySelectorAll("a[data-keeps-ticks]")) link.href = this.withTicks(link.href);
    this.show();
  }

  withTicks(href) {
    const address = new URL(href);
    address.searchParams.delete(this.one);
    for (const name of this.names) address.searchParams.append(this.one, name);
    return address.href;
  }

  show() {
    const { length } = this.names;
    const unseen = this.others.length + this.boxes.filter((box) => box.checked && isHidden(box)).length;
    this.bar.hidden = length === 0;
    const most = length >= MOST ? `. ${texts.tickedMost(MOST, this.one)}.` : "";
    setText(this.count, texts.ticked(length, this.one, unseen) + most);
  }
}

const isHidden = (box) => box.closest("tr").hidden;
