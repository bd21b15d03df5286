// Small things that every part of the page uses: elements, questions to the server, numbers in words.

export const make = (parent, tag, attributes = {}, text) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name === "class") element.className = value;
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  if (text !== undefined) element.textContent = text; // names out of a log are text and nothing else
  if (parent) parent.append(element);
  return element;
};

export const button = (parent, text, act, attributes = {}) => {
  const made = make(parent, "button", { type: "button", ...attributes }, text);
  made.addEventListener("click", act);
  return made;
};

export const menu = (parent, label, choices, chosen, change, attributes = {}) => {
  const made = make(parent, "select", { "aria-label": label, ...attributes });
  for (const [value, text] of choices) make(made, "option", { value }, text);
  made.value = chosen;
  made.addEventListener("change", () => change(made.value));
  return made;
};

export const field = (parent, label, value, change, attributes = {}) => {
  const made = make(parent, "input", { "aria-label": label, ...attributes });
  made.value = value ?? "";
  made.addEventListener("change", () => change(made.value));
  return made;
};

const answer = async (response) => {
  if (!(response.headers.get("Content-Type") ?? "").startsWith("application/json")) throw new Error(await response.text());
  const told = await response.json();
  if (!response.ok) throw new Error(told.error ?? response.statusText);
  return told;
};

export const ask = async (name, asked = {}) => answer(await fetch(`api/${name}?${new URLSearchParams(asked)}`));

export const tell = async (name, content) =>
  answer(await fetch(`api/${name}`, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(content) }));

// Ask until the work behind a question is done; `show` hears of its progress.
export const until = async (question, show = () => {}) => {
  for (let wait = 100; ; wait = Math.min(wait * 1.4, 1000)) {
    const told = await question();
    if (told.state !== "working" && told.state !== "stopping") return told;
    show(told);
    await new Promise((resolve) => setTimeout(resolve, wait));
  }
};

export const nice = (least) => {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * ([1, 2, 5, 10].find((factor) => factor * power >= least * 0.999999) ?? 10);
};
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 36000, 86400];
export const niceTime = (least) => (least <= 0.5 ? nice(least) : STEPS.find((step) => step >= least) ?? nice(least / 86400) * 86400);
export const digits = (step) => Math.max(0, Math.min(9, -Math.floor(Math.log10(step) + 1e-9)));

const pad = (value, wide = 2) => String(value).padStart(wide, "0");
// Time of a log as h:mm:ss, or of the day where its clock is known; as many decimals as the step asks for.
export const clock = (seconds, step, startUtc = null) => {
  const places = step < 1 ? digits(step) : 0;
  const total = (startUtc ?? 0) + seconds;
  let whole = Math.floor(total + 0.5 * 10 ** -places);
  let rest = Math.max(0, Math.round((total - whole) * 10 ** places));
  if (rest >= 10 ** places) [whole, rest] = [whole + 1, 0];
  const tail = places ? `.${pad(rest, places)}` : "";
  if (startUtc !== null) {
    const at = new Date(whole * 1000);
    return `${pad(at.getUTCHours())}:${pad(at.getUTCMinutes())}:${pad(at.getUTCSeconds())}${tail}`;
  }
  const sign = whole < 0 ? "−" : "";
  whole = Math.abs(whole);
  return `${sign}${Math.floor(whole / 3600)}:${pad(Math.floor(whole / 60) % 60)}:${pad(whole % 60)}${tail}`;
};
export const day = (seconds, startUtc) => new Date((startUtc + seconds) * 1000).toISOString().slice(0, 10);

export const short = (value, figures = 5) => {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = Number(value.toPrecision(figures));
  return Math.abs(text) >= 1e6 || (text && Math.abs(text) < 1e-4) ? text.toExponential() : String(text);
};
export const hertz = (range) => {
  if (!range) return "";
  const [first, last] = range.map((value) => short(value, 3));
  return first === last ? `${first} Hz` : `${first} to ${last} Hz`;
};
