// Search, filters, order and the choice of cards or table. What is chosen stands in the page's address.

import { LocalStore, foldFilters, part, setText } from "../dom/page.js";
import { fleet as texts } from "../texts/fleet.js";
import { fromQuery, isFiltered, sitesOf, toQuery } from "./filters.js";

const VIEW = "fleet.view";
const ANY_SITE = "any";

export class Toolbar {
  // `onFilter()` and `onView(view)` when the person chose; `filter` and `view` say what.
  constructor(root, { onFilter, onView }) {
    this.root = root;
    this.onFilter = onFilter;
    this.onView = onView;
    this.store = new LocalStore();
    this.filter = fromQuery(location.search);
    this.view = this.store.read(VIEW) === "table" ? "table" : "cards";
    this.search = part(root, "search");
    this.site = part(root, "site");
    this.sort = part(root, "sort");
    this.listen();
    this.show();
    this.offerSites([]);
    foldFilters(root.querySelector("search"), isFiltered(this.filter));
  }

  listen() {
    this.search.addEventListener("input", () => this.choose({ words: this.search.value }));
    this.site.addEventListener("change", () => this.choose({ site: siteOf(this.site.value) }));
    this.sort.addEventListener("change", () => this.choose({ sort: this.sort.value, down: false }));
    part(this.root, "show-all").addEventListener("click", () => this.choose({ words: "", site: null, states: [] }));
    for (const button of this.buttons("state")) button.addEventListener("click", () => this.turn(button.dataset.state));
    for (const button of this.buttons("view")) button.addEventListener("click", () => this.chooseView(button.dataset.view));
    for (const button of this.buttons("by")) button.addEventListener("click", () => this.sortBy(button.dataset.by));
  }

  buttons(kind) {
    return this.root.querySelectorAll(`button[data-${kind}]`);
  }

  turn(state) {
    const { states } = this.filter;
    this.choose({ states: states.includes(state) ? states.filter((other) => other !== state) : [...states, state] });
  }

  // The same column again turns its order around.
  sortBy(sort) {
    this.choose({ sort, down: this.filter.sort === sort && !this.filter.down });
  }

  choose(changes) {
    Object.assign(this.filter, changes);
    history.replaceState(null, "", location.pathname + toQuery(this.filter));
    this.show();
    this.onFilter();
  }

  chooseView(view) {
    this.view = view;
    this.store.write(VIEW, view);
    this.show();
    this.onView(view);
  }

  show() {
    const { words, site, states, sort, down } = this.filter;
    if (this.search.value.trim() !== words.trim()) this.search.value = words;
    this.site.value = site === null ? ANY_SITE : `site ${site}`;
    this.sort.value = sort;
    for (const button of this.buttons("state")) press(button, states.includes(button.dataset.state));
    for (const button of this.buttons("view")) press(button, button.dataset.view === this.view);
    for (const button of this.buttons("by")) markSort(button, sort, down);
    part(this.root, "show-all").hidden = !isFiltered(this.filter);
  }

  // The sites of the robots; the one that is asked for stays, also when no robot is there.
  offerSites(robots) {
    const { site } = this.filter;
    const sites = sitesOf(site === null ? robots : [...robots, { site }]);
    const wanted = sites.join("\n");
    if (wanted === this.offered) return;
    this.offered = wanted;
    const options = sites.map((name) => new Option(name || texts.noSite, `site ${name}`));
    this.site.replaceChildren(new Option(texts.allSites, ANY_SITE), ...options);
    this.site.value = site === null ? ANY_SITE : `site ${site}`;
  }

  // How many robots there are, and how many of them are shown.
  count({ online, all, shown }) {
    const words = all ? texts.count(online, all) : "";
    setText(part(this.root, "count"), isFiltered(this.filter) ? texts.shown(words, shown) : words);
    part(this.root, "none-fits").hidden = all === 0 || shown > 0;
  }
}

const siteOf = (value) => (value === ANY_SITE ? null : value.slice("site ".length));

const press = (button, pressed) => button.setAttribute("aria-pressed", String(pressed));

function markSort(button, sort, down) {
  const header = button.closest("th");
  if (button.dataset.by !== sort) header.removeAttribute("aria-sort");
  else header.setAttribute("aria-sort", down ? "descending" : "ascending");
}
