// The desk: a slider moves, the ROC follows; when it rests, the curve is drawn again, coarse first.
const form = document.getElementById("desk");
const REST_MS = 350, SLOW_MS = 400;
const at = (id) => document.getElementById(id);
const slides = [...form.querySelectorAll(".slide")].map((row) => row.querySelectorAll("input"));

// Sliders that stand as in the scenario are not sent: their six digits are no other value.
form.addEventListener("formdata", ({ formData }) => {
  for (const [, box] of slides) if (box.value === box.dataset.now) formData.delete(box.name);
});

// What is chosen, as an address.
function query() {
  const chosen = new URLSearchParams();
  for (const [name, value] of new FormData(form)) if (value !== "") chosen.append(name, value);
  return chosen;
}

// A slider's place, from 0 to 1000, and its number.
const scaled = ({ dataset }, value) => ("log" in dataset ? Math.log(value) : Number(value));
function place(range, value) {
  const [low, high] = [range.dataset.low, range.dataset.high].map((end) => scaled(range, end));
  range.value = (1000 * (scaled(range, value) - low)) / (high - low);
}
function valueOf(range) {
  const [low, high] = [range.dataset.low, range.dataset.high].map((end) => scaled(range, end));
  const value = low + ((high - low) * range.value) / 1000;
  return Number(("log" in range.dataset ? Math.exp(value) : value).toPrecision(4));
}

function mistaken(errors) {
  for (const old of form.querySelectorAll(".mistake.told")) old.remove();
  for (const box of form.querySelectorAll("[aria-invalid]")) box.removeAttribute("aria-invalid");
  for (const { field, message } of errors) {
    const found = field && form.elements[field], box = found?.length !== undefined && !found.options ? found[0] : found;
    const words = document.createElement("span");
    words.className = "mistake told";
    words.textContent = message;
    box?.setAttribute?.("aria-invalid", "true");
    (box?.closest(".pair, .slide, fieldset") ?? at("left")).after(words);
  }
}

async function asked(address, signal) {
  const answer = await fetch(address, { signal });
  if (answer.ok) return answer;
  mistaken((await answer.json()).errors);
  return null;
}

const draw = async (id, text) => {
  const figure = JSON.parse(text);
  if (moveLines(at(id), figure)) return;
  for (const view of figure.views) { view.tab ??= ""; view.subject ??= ""; }
  await show(at(id), figure, { tab: "", subject: "" });
};

// One question at a time: what was asked meanwhile is asked when it is answered, what takes too long is dropped.
let onItsWay = null, isWaiting = false;
async function live(limits = "") {
  if (onItsWay !== null) {
    isWaiting = true;
    return;
  }
  const begun = performance.now();
  onItsWay = new AbortController();
  const slow = setTimeout((controller) => isWaiting && controller.abort(), SLOW_MS, onItsWay);
  try {
    const answer = await asked(`/trade/live?${query()}${limits}`, onItsWay.signal);
    if (answer !== null) {
      const told = await answer.json();
      mistaken([]);
      await draw("live", told.figure);
      const digits = (value) => Number(value.toPrecision(4)).toString();
      at("now").textContent = told.values.map(([name, value]) => `${name}: ${value === null ? "none" : digits(value)}`).join("; ") + ".";
      at("error").textContent = told.error;
      at("live").dataset.ms = Math.round(performance.now() - begun);
      at("live").dataset.count = Number(at("live").dataset.count ?? 0) + 1;
    }
  } catch (error) {
    if (error.name !== "AbortError") throw error;
  }
  clearTimeout(slow);
  onItsWay = null;
  if (isWaiting) {
    isWaiting = false;
    await live();
  }
}

let stream = null;
async function curve() {
  stream?.abort();
  const own = (stream = new AbortController());
  at("left").textContent = "Computing …";
  try {
    const answer = await asked(`/trade/curve?${query()}`, own.signal);
    if (answer === null) return;
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let rest = "", part = await reader.read(); !part.done; part = await reader.read()) {
      const lines = (rest + part.value).split("\n");
      rest = lines.pop();
      for (const told of lines.map(JSON.parse)) {
        if (told.figure) await draw("trade", told.figure);
        own.signal.throwIfAborted();
        at("needed").textContent = (told.needed ?? []).map((words) => `${words}.`).join(" ");
        at("left").textContent = told.error ?? (told.left > 0 ? "Computing …" : "");
        if (told.left === 0) at("trade").dataset.ready = "yes";
      }
    }
  } catch (error) {
    if (error.name !== "AbortError") throw error;
  }
}

function remember() {
  const chosen = query();
  history.replaceState(null, "", `/trade?${chosen}`);
  for (const link of document.querySelectorAll(".away")) link.search = chosen;
}

let rest = null;
function changed() {
  stream?.abort();
  delete at("trade").dataset.ready;
  clearTimeout(rest);
  rest = setTimeout(async () => {
    remember();
    await live("&limits=1");
    curve();
  }, REST_MS);
  live();
}

for (const [range, box] of slides) {
  place(range, box.value);
  range.addEventListener("input", () => { box.value = valueOf(range); changed(); });
  box.addEventListener("input", () => { place(range, box.value); changed(); });
}
at("back").addEventListener("click", () => {
  for (const [range, box] of slides) place(range, (box.value = box.dataset.now));
  changed();
});
// Another scenario, target or axis has other fields: the page is made anew, with all that still holds.
form.addEventListener("change", ({ target }) => {
  if (target.name === "scenario") location.assign(`/trade?scenario=${encodeURIComponent(target.value)}`);
  else if (target.dataset.new !== undefined || target.name === "side_m") {
    if (target.name === "sensor") at("own-sensor").disabled = target.value === "";
    const chosen = query();
    for (const name of ["x", "y"]) if (target.name === name) for (const end of ["from", "to"]) chosen.delete(`${name}_${end}`);
    if (["output", "side_m"].includes(target.name)) for (const name of ["x", "x_from", "x_to", "y", "y_from", "y_to", ...(target.name === "output" ? ["subject", "wanted"] : [])]) chosen.delete(name);
    location.assign(`/trade?${chosen}`);
  } else if (target.type !== "range" && !target.name.startsWith("at:")) changed();
});
// Enter takes what is typed, as leaving the field does; the button alone orders a run.
form.addEventListener("keydown", (event) => {
  if (event.key !== "Enter" || event.target.tagName !== "INPUT") return;
  event.preventDefault();
  event.target.blur();
  event.target.focus();
});
remember();
live("&limits=1").then(curve);
