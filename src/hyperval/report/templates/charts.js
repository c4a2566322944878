// Unpacks the library, draws each chart of the page and shows the subject that is chosen; the charts hold no code.
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const numbers = (text) => new Float32Array(bytes(text).buffer);

// Columns of a subject: of a value and its half-width, the limits follow.
function columns(chart, subject) {
  const data = { nm: numbers(subject.columns.nm ?? chart.subjects[0].columns.nm) };
  for (const [name, [value, half]] of Object.entries(subject.bands)) {
    data[name] = numbers(value);
    const width = numbers(half);
    data[`${name}_low`] = data[name].map((v, i) => v - width[i]);
    data[`${name}_high`] = data[name].map((v, i) => v + width[i]);
  }
  return data;
}

// Of curves, those of one subject alone, or the first few.
function showCurves(root, name) {
  const curves = root.tabs.flatMap((tab) => tab.child.renderers).filter((curve) => curve.tags.length > 0);
  for (const curve of curves) curve.visible = name === null ? curve.tags[1] : curve.tags[0] === name;
}

// Numbers of a chart go into its models by their names.
function fillIn(plots, { sources, ranges, spans, arrays, colours = {}, texts = {}, names = {} }) {
  const values = arrays.map(numbers);
  for (const [name, columns] of Object.entries(sources))
    plots.get_model_by_name(name).data = {
      ...Object.fromEntries(Object.entries(columns).map(([column, i]) => [column, values[i]])), ...texts[name],
    };
  for (const [name, [low, high]] of Object.entries(colours)) plots.get_model_by_name(name).setv({ low, high });
  setRanges(plots, ranges);
  for (const [name, location] of Object.entries(spans)) plots.get_model_by_name(name).location = location;
  for (const [name, places] of Object.entries(names)) {
    const axis = plots.get_model_by_name(name);
    axis.major_label_overrides = new Map(places.map((place, i) => [i, place]));
    axis.ticker.ticks = [...places.keys()];
  }
}

function setRanges(plots, ranges) {
  for (const [name, [start, end]] of Object.entries(ranges))
    plots.get_model_by_name(name).setv({ start, end, reset_start: start, reset_end: end });
}

async function draw(chart) {
  await Bokeh.embed.embed_item(chart.item);
  const plots = Bokeh.documents.at(-1); // charts number their models alike: the last document is this one's
  fillIn(plots, chart.fill);
  const choice = document.querySelector(`select[data-chart="${chart.item.target_id}"]`);
  if (chart.subjects.length === 0) {
    const chosen = () => showCurves(plots.roots()[0], choice.selectedIndex === 0 ? null : choice.value);
    choice?.addEventListener("change", chosen);
    if (choice?.selectedIndex > 0) chosen();
    return;
  }
  const show = (number) => {
    const subject = chart.subjects[number];
    if (subject.sources !== undefined) return fillIn(plots, subject);
    plots.get_model_by_name("spectra").data = columns(chart, subject);
    setRanges(plots, subject.ranges);
  };
  show(Math.max(choice?.selectedIndex ?? 0, 0));
  choice?.addEventListener("change", () => show(choice.selectedIndex));
}

async function unpackLibrary() {
  const packed = new Blob([bytes(document.getElementById("library").textContent)]).stream();
  const library = document.createElement("script");
  library.textContent = await new Response(packed.pipeThrough(new DecompressionStream("gzip"))).text();
  document.head.append(library);
}

// One after the other, as they come near the screen; those that are folded when they are unfolded, which brings them
// there.  The others follow while nobody asks for anything, so that they are there when the page is printed.
function drawAll() {
  const left = new Map([...document.querySelectorAll("script.chart")].map((s) => [s.previousElementSibling, s]));
  let drawn = null;
  const next = (place) => {
    const content = left.get(place);
    left.delete(place);
    near.unobserve(place);
    return (drawn = (drawn ?? unpackLibrary()).then(() => draw(JSON.parse(content.textContent))));
  };
  const near = new IntersectionObserver(
    (places) => places.filter((place) => place.isIntersecting).forEach((place) => next(place.target)),
    { rootMargin: "50%" },
  );
  for (const place of left.keys()) near.observe(place);
  const idle = globalThis.requestIdleCallback ?? ((rest) => setTimeout(rest, 200));
  const rest = async () => {
    await drawn;
    const place = [...left.keys()].find((one) => one.closest("details:not([open])") === null);
    if (place !== undefined) next(place).then(() => idle(rest));
  };
  addEventListener("load", () => idle(rest));
  document.addEventListener("toggle", () => idle(rest), true);
}
// Another page may bring the library and the charts by itself.
if (document.getElementById("library") !== null) drawAll();
