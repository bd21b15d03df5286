// The form for a ship of one's own: it writes a vessel file, which the trial then names.

import { button, field, make, tell } from "./tools.js";

export const vesselForm = (box, draft) => {
  const { fields, file } = draft.vessel_form, values = { name: draft.state.name };
  let name = file;
  make(box, "summary", {}, "A ship of your own");
  make(box, "p", { class: "soft told" }, "Its name and gear ratio are enough; the rest as far as it is known.");
  for (const { key, is_table: isTable, example, about } of fields) {
    const last = key.split(".").pop().replaceAll("_", " ");
    if (isTable) {
      make(box, "h3", {}, last);
      if (about) make(box, "p", { class: "soft told" }, about);
      continue;
    }
    const line = make(box, "label", { class: "line" });
    make(line, "span", { class: "key" }, key.split(".").pop());
    field(line, key, values[key] ?? "", (text) => { values[key] = text; }, { class: "short", placeholder: example.replaceAll('"', "") });
    if (about) make(line, "span", { class: "soft" }, about);
  }
  const line = make(box, "div", { class: "line" });
  make(line, "span", { class: "soft" }, "into the file");
  const into = field(line, "file of the ship", name, (text) => { name = text.trim(); }, { class: "short" });
  const told = make(box, "p", { class: "told", role: "status" });
  button(line, "write and use it", async () => {
    try {
      const written = await tell("vessel", { file: name, values });
      draft.vessels = written.vessels;
      draft.state.vessel = written.file;
      draft.change();
      [told.className, told.textContent] = ["told good", `${written.file} is written, and is the trial's ship.`];
      into.value = name = "";
    } catch (error) {
      [told.className, told.textContent] = ["told bad", error.message];
    }
  }, { class: "main" });
};
