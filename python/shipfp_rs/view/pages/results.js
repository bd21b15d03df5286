// Finished runs and sweeps of the folder, and their reports beside the plot.

import { ask, button, make } from "./tools.js";

export const verdictBox = (parent, folder, verdict, open) => {
  make(parent, "p", { class: "told good" }, `wrote ${folder}`);
  button(parent, "open the report beside", open, { class: "main" });
  const list = make(parent, "ul");
  for (const line of verdict) make(list, "li", { class: "told" }, line);
};

export class ResultsPanel {
  constructor(box, beside = true) {
    Object.assign(this, { box, beside });
    document.addEventListener("panel", (event) => {
      document.getElementById("panel")?.classList.toggle("wide", event.detail === "results");
      if (event.detail === "results") this.load();
    });
    document.addEventListener("finished", (event) => { this.wanted = event.detail; });
  }

  async load() {
    const { box } = this;
    const told = await ask("results").catch((error) => ({ results: [], error: error.message }));
    box.replaceChildren();
    this.place = make(null, "div");
    if (!told.results.length) make(box, "p", { class: "soft" }, told.error ?? "No finished run or sweep in this folder yet.");
    for (const one of told.results) this.card(one, told.base);
    box.prepend(this.place);
    const wanted = told.results.find((one) => one.name === this.wanted);
    if (wanted) this.show(wanted, told.base);
    this.wanted = null;
  }

  card(one, base) {
    const card = make(this.box, "div", { class: "card" });
    const line = make(card, "div", { class: "line" });
    make(line, "strong", { class: "grow" }, one.name);
    make(line, "span", { class: "soft" }, `${one.kind}, ${new Date(one.changed * 1000).toLocaleString("sv").slice(0, 16)}`);
    make(card, "p", { class: "soft told" }, one.about);
    make(card, "p", { class: "told" }, one.verdict);
    const links = make(card, "div", { class: "line" });
    const link = (file, text, kind) => make(links, "a", { class: kind, href: `${base}${one.id}/${encodeURIComponent(file)}`, target: "_blank", rel: "noopener noreferrer" }, text);
    if (one.files.includes("report.html")) link("report.html", "open the report", "main");
    if (one.files.includes("report.html") && this.beside) button(links, "report beside", () => this.show(one, base));
    for (const file of one.files.filter((file) => file !== "report.html")) link(file, file);
  }

  show(one, base) {
    this.place.replaceChildren();
    if (!one.files.includes("report.html")) return;
    make(this.place, "iframe", { src: `${base}${one.id}/report.html`, title: `report of ${one.name}`, sandbox: "allow-scripts" });
  }
}
