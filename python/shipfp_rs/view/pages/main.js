// The page of one log: waits until it is read, then puts the parts together.

import { View } from "./view.js";
import { ChannelsPanel, TrialPanel } from "./trial.js";
import { Draft } from "./draft.js";
import { ResultsPanel } from "./results.js";
import { SpectrumPanel } from "./spectrum.js";
import { Faults } from "./faults.js";
import { ask, button, clock, make, short, until } from "./tools.js";

const doc = Number(new URLSearchParams(location.search).get("doc") ?? 0);
const status = document.getElementById("status");
const say = (text, tone = "") => { status.textContent = text; status.className = tone; };

const PANELS = { channels: "Channels", trial: "Trial", spectrum: "Spectrum", results: "Results", keys: "Keys" };
const KEYS = [
  ["← →", "earlier, later"], ["+ −", "zoom in, out"], ["0", "show all"], ["Home End", "to the beginning, to the end"],
  ["[ ]", "move the cursor by a pixel"], ["c", "pin the cursor: the other one then tells differences"], ["Esc", "no cursor, no marking"],
  ["w", "mark a window by a drag"], ["s", "mark the steady stretch by a drag"], ["n p", "next, previous fault"],
  ["r d f", "raw, processed, faults: on and off"], ["u", "calibrated or as recorded"], ["t", "time of day or since the start"], ["?", "this list"],
];

const showPanel = (name) => {
  for (const key of Object.keys(PANELS)) {
    document.getElementById(key).classList.toggle("shown", key === name);
    document.getElementById(`tab-${key}`).setAttribute("aria-selected", String(key === name));
  }
  document.dispatchEvent(new CustomEvent("panel", { detail: name }));
};

const tabs = () => {
  const bar = document.getElementById("tabs");
  for (const [key, text] of Object.entries(PANELS)) {
    button(bar, text, () => showPanel(key), { role: "tab", id: `tab-${key}`, "aria-controls": key, "aria-selected": "false" });
  }
  const list = make(document.getElementById("keys"), "table");
  for (const [key, what] of KEYS) {
    const line = make(list, "tr");
    make(make(line, "td"), "kbd", {}, key);
    make(line, "td", {}, what);
  }
  make(document.getElementById("keys"), "p", { class: "soft" },
    "Wheel: zoom about the pointer; with Shift, or sideways: move; with Alt: scroll the rows. Drag: zoom in; with Alt or the middle button: move. Click: pin the cursor. Double click: all. Touch: one finger moves, two zoom.");
};

const toolbar = (view, faults) => {
  const bar = document.getElementById("tools");
  button(bar, "all", () => view.all(), { title: "show all (0)" });
  button(bar, "+", () => view.zoom(0.5, 0.5 * (view.from + view.to)), { "aria-label": "zoom in" });
  button(bar, "−", () => view.zoom(2, 0.5 * (view.from + view.to)), { "aria-label": "zoom out" });
  button(bar, "‹", () => view.shift(-0.5), { "aria-label": "earlier" });
  button(bar, "›", () => view.shift(0.5), { "aria-label": "later" });
  const toggles = { raw: "raw", processed: "processed", faults: "faults", calibrated: "calibrated" };
  const drawn = {};
  for (const [layer, text] of Object.entries(toggles)) {
    drawn[layer] = button(bar, text, () => toggle(layer), { "aria-pressed": String(view.layers[layer]) });
  }
  const toggle = (layer) => {
    view.layers[layer] = !view.layers[layer];
    drawn[layer].setAttribute("aria-pressed", String(view.layers[layer]));
    view.dispatchEvent(new Event("layers"));
    view.arrange();
  };
  button(bar, "fault ›", () => faults.next(1), { "aria-label": "next fault" });
  const modes = { window: "mark window", steady: "mark steady" };
  const marking = Object.entries(modes).map(([mode, text]) => [mode, button(bar, text, () => view.setMode(mode), { "aria-pressed": "false" })]);
  view.addEventListener("mode", () => {
    for (const [mode, made] of marking) made.setAttribute("aria-pressed", String(view.mode === mode));
    if (view.mode) say(view.mode === "window" ? "Drag over the stretch that is an experiment." : "Drag over a stretch with a constant set point.");
  });
  return toggle;
};

const listenToKeys = (view, faults, toggle) => {
  const pixel = () => (view.to - view.from) / view.inner;
  const middle = () => view.pointer ?? 0.5 * (view.from + view.to);
  const keys = {
    ArrowLeft: () => view.shift(-0.25), ArrowRight: () => view.shift(0.25), "+": () => view.zoom(0.5), "=": () => view.zoom(0.5),
    "-": () => view.zoom(2), "−": () => view.zoom(2), 0: () => view.all(),
    Home: () => view.show(view.first, view.first + view.to - view.from), End: () => view.show(view.last - view.to + view.from, view.last),
    "[": () => view.setPointer(Math.max(middle() - pixel(), view.from)), "]": () => view.setPointer(Math.min(middle() + pixel(), view.to)),
    c: () => view.togglePin(middle()), w: () => view.setMode("window"), s: () => view.setMode("steady"),
    Escape: () => { view.pinned = null; if (view.mode) view.setMode(view.mode); view.setPointer(null); },
    n: () => faults.next(1), p: () => faults.next(-1), r: () => toggle("raw"), d: () => toggle("processed"), f: () => toggle("faults"),
    u: () => toggle("calibrated"), t: () => { view.absolute = !view.absolute; view.later(); }, "?": () => showPanel("keys"),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest("input, select, textarea, [role=tab]")) return;
    const act = keys[event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });
};

const start = async () => {
  tabs();
  showPanel("channels");
  say("reading the log …");
  let facts;
  try {
    const waited = await until(() => ask("document", { doc }), (told) => say(`reading the log, ${Math.round(100 * (told.progress ?? 0))} % …`));
    if (waited.state === "failed") throw new Error(waited.error);
    facts = waited;
  } catch (error) {
    say(error.message, "bad");
    return;
  }
  document.getElementById("title").textContent = document.title = facts.trial ? `${facts.trial}: ${facts.name}` : facts.name;
  const view = new View(doc);
  view.load(facts);
  const faults = new Faults(view, doc, say, Boolean(facts.trial));
  const draft = new Draft(view, doc, say);
  new ChannelsPanel(view, draft);
  new TrialPanel(view, draft, doc, say, showPanel);
  new SpectrumPanel(view, doc);
  new ResultsPanel(document.getElementById("results"));
  listenToKeys(view, faults, toolbar(view, faults));
  view.addEventListener("failed", (event) => say(`not drawn to the last sample: ${event.detail}; is shipfp view still running?`, "bad"));
  view.addEventListener("cursor", () => {
    const at = view.pointer ?? view.pinned;
    if (at === null || at === undefined) return;
    const step = Math.min((view.to - view.from) / 1000, 1);
    let text = clock(at, step, view.absolute ? view.startUtc : null);
    if (view.startUtc !== null && view.absolute) text += ` (${at.toFixed(3)} s)`;
    if (view.pinned !== null && view.pointer !== null) {
      const apart = view.pointer - view.pinned;
      text += ` · Δt ${short(apart, 6)} s${apart ? ` · 1/Δt ${short(1 / Math.abs(apart), 4)} Hz` : ""}`;
    }
    say(text);
  });
  window.shipfp = { view, draft, faults }; // for the tests and the benchmark
  await view.whenSettled();
  say(`${facts.series.length} channels, ${clock(view.last - view.first, 1)} long, ${facts.series.reduce((sum, one) => sum + one.samples, 0).toLocaleString("en")} samples`);
  document.body.dataset.ready = "true";
  await draft.load();
  faults.load();
};

start();
