// The page of a folder: its logs, trials, runs and sweeps.

import { ResultsPanel } from "./results.js";
import { ask, make } from "./tools.js";

const list = (id, entries, text, empty) => {
  const box = document.getElementById(id);
  box.className = "plain";
  for (const entry of entries) {
    const line = make(box, "li", { class: "card" });
    make(line, "a", { href: `look.html?doc=${entry.doc}` }, entry.name);
    make(line, "span", { class: "soft" }, ` ${text(entry)}`);
  }
  if (!entries.length) make(box, "li", { class: "soft" }, empty);
};

const size = (bytes) => (bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`);

const start = async () => {
  const told = await ask("folder");
  document.getElementById("title").textContent = document.title = told.folder || "folder";
  list("logs", told.logs, (log) => size(log.bytes), "no log in this folder");
  list("trials", told.trials, (trial) => `of ${trial.log}`, "no trial in this folder yet: open a log and say what its channels are");
  if (told.others.length) make(document.getElementById("trials"), "li", { class: "soft" }, `no trials: ${told.others.join(", ")}`);
  await new ResultsPanel(document.getElementById("results"), false).load();
  document.body.dataset.ready = "true";
};

start().catch((error) => { document.getElementById("title").textContent = error.message; });
