// Draws the stated figures of a page with BokehJS; the statements hold no code.  Colours are those of white paper: the
// style of the page turns them on a dark screen.
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const numbers = (text) => new Float32Array(bytes(text).buffer);
const f = (field) => ({ field });
const INK = "#1d1d1f", SOFT = "#4d5157", GRID = "#e3e5e8", ABSORPTION = "#e9e9e9";
const CURVES = ["#0072B2", "#C2410C", "#009E73", "#B4548F", "#5B3A8C", "#B58900"];
const FIRST = "the first few"; // subjects that are seen over each other before a name is clicked
const FEW = 3;
const NARROW = 560; // [px] a phone
const FEW_DECADES = 10 ** 2.5;
const isNarrow = () => document.documentElement.clientWidth < NARROW;
const sum = (values) => values.reduce((a, b) => a + b, 0);

function columnsOf(figure, mark) {
  figure.arrays ??= figure.columns.map(numbers);
  const data = Object.fromEntries(Object.entries(mark.columns).map(([name, i]) => [name, figure.arrays[i]]));
  if (data.half !== undefined) {
    data.low = data.y.map((v, i) => v - data.half[i]);
    data.high = data.y.map((v, i) => v + data.half[i]);
  }
  // Where both ends are the value nothing is stated.
  if (mark.kind !== "area" && data.low !== undefined && !data.low.some((v, i) => v < data.high[i])) delete data.low, delete data.high;
  if (mark.words !== undefined) data.words = mark.words;
  if (mark.shades !== undefined) data.shade = mark.shades;
  return data;
}

// An area in pieces: it would not break where a number is missing.
function area(plot, { x, low, high }, fill) {
  const drawn = [];
  for (let i = 0, j; i < x.length; i = j + 1) {
    for (j = i; j < x.length && !Number.isNaN(low[j] + high[j] + x[j]); j++);
    const piece = (values) => Array.from(values.slice(i, j));
    if (j > i + 1) drawn.push(plot.varea({ x: piece(x), y1: piece(low), y2: piece(high), ...fill }));
  }
  return drawn;
}

const SHAPES = { tick: "dash", left: "triangle", right: "triangle" };
const turned = (mark) => ({ tick: mark.along === "x" ? Math.PI / 2 : 0, left: Math.PI / 2, right: -Math.PI / 2 })[mark.marker] ?? 0;

// The renderers of one mark; the last is the one that tells what the pointer rests on.
function drawMark(plot, mark, source) {
  const { colour, kind } = mark, data = source.data, alpha = mark.alpha ?? 0;
  const sideways = mark.along === "x", line = { line_color: colour, line_width: 1.6 };
  const mapped = mark.scale && { field: "value", transform: colours(plot, mark.scale) };
  let drawn = [];
  if (data.low !== undefined && ["line", "steps", "area"].includes(kind)) drawn = area(plot, data, { fill_color: colour, fill_alpha: alpha });
  else if (data.low !== undefined) {
    const ends = sideways ? { x0: f("low"), x1: f("high"), y0: f("y"), y1: f("y") } : { x0: f("x"), x1: f("x"), y0: f("low"), y1: f("high") };
    drawn = [plot.segment({ ...ends, source, ...line, line_width: 2 })];
  }
  if (kind === "line") drawn.push(plot.line({ x: f("x"), y: f("y"), source, ...line, line_dash: mark.dash }));
  if (kind === "steps") drawn.push(plot.step({ x: f("x"), y: f("y"), source, ...line, line_dash: mark.dash, mode: "after" }));
  if (kind === "line" && mark.linked) { // bands that are chosen stand out
    drawn.push(plot.scatter({ x: f("x"), y: f("y"), source, size: 5, fill_color: colour, line_color: colour, fill_alpha: 0, line_alpha: 0 }));
    const glyph = drawn.at(-1);
    glyph.selection_glyph?.setv({ fill_alpha: 1, line_alpha: 1 });
    glyph.nonselection_glyph?.setv?.({ fill_alpha: 0, line_alpha: 0 });
  }
  if (mark.marker !== undefined) {
    const size = data.size !== undefined ? f("size") : mark.marker === "tick" ? 14 : 8;
    const fill = mapped ? { fill_color: mapped, line_color: SOFT } : { fill_color: mark.hollow ? "white" : colour, line_color: colour };
    drawn.push(plot.scatter({ x: f("x"), y: f("y"), source, size, angle: turned(mark), marker: SHAPES[mark.marker] ?? mark.marker, line_width: 1.4, ...fill }));
  }
  if (kind === "bars" || kind === "cells") {
    const fill = mapped ? { fill_color: mapped, line_color: null } : { fill_color: colour, fill_alpha: alpha, line_color: colour, line_alpha: alpha < 1 ? Math.min(2 * alpha, 1) : 0 };
    drawn.push(plot.quad({ left: f("left"), right: f("right"), bottom: f("bottom"), top: f("top"), source, ...fill }));
    const middle = (a, b) => data[a].map((v, i) => 0.5 * (v + data[b][i]));
    Object.assign(data, { y: middle("bottom", "top"), x: mark.beside === "centre" ? middle("left", "right") : data[mark.beside === "left" ? "left" : "right"] });
  }
  if (mark.beside !== undefined) {
    const away = data.size !== undefined ? 10 : 6, centre = mark.beside === "centre";
    plot.text({
      x: f("x"), y: f("y"), text: f("words"), source, text_baseline: "middle", text_font_size: "11px",
      text_align: { left: "right", right: "left", centre: "center" }[mark.beside],
      x_offset: { left: -away, right: away, centre: 0 }[mark.beside], text_color: centre && mark.shades ? f("shade") : SOFT,
    });
  }
  return drawn;
}

function colours(plot, scale) {
  const mapper = new Bokeh.LinearColorMapper({ palette: scale.palette, low: scale.low, high: scale.high });
  if (scale.label !== undefined && scale.label !== "" && !isNarrow()) {
    plot.add_layout(new Bokeh.ColorBar({ color_mapper: mapper, title: scale.label, background_fill_alpha: 0, title_text_color: INK, major_label_text_color: INK }), "right");
  }
  return mapper;
}

// Names and notes of plots that stand above each other have common columns.
const pen = document.createElement("canvas").getContext("2d");
function borders(parts) {
  pen.font = "12px system-ui, Liberation Sans, Arial, sans-serif";
  const widest = (key) => Math.max(0, ...parts.flatMap((part) => part.y[key] ?? []).map((words) => pen.measureText(words).width));
  return { left: Math.max(widest("names") * 1.06 + 18, 72), right: widest("notes") > 0 ? widest("notes") * 1.06 + 18 : 0 };
}

const named = (axis) => axis.scale === "names";

function tips(mark, x, y, data) {
  const said = [], value = data.low !== undefined;
  if (mark.label !== undefined) said.push(["", mark.label.replace(/[@$]/g, "")]);
  if (mark.words !== undefined && mark.beside !== "centre") said.push(["", "@words"]);
  if (mark.kind === "cells" || mark.scale !== undefined) said.push([mark.scale?.label ?? "", "@value"]);
  if (mark.kind === "bars" && !named(x)) said.push([x.label ?? "", "@left to @right"]);
  if (mark.kind !== "bars" && mark.kind !== "cells") {
    if (!named(x)) said.push([x.label ?? "", "@x" + (value && mark.along === "x" ? " (@low to @high)" : "")]);
    if (!named(y)) said.push([y.label ?? "", mark.kind === "area" ? "@low to @high" : "@y" + (value && mark.along !== "x" ? " (@low to @high)" : "")]);
  }
  return said;
}

// On a phone the unit of a long label stands below it.
const labelOf = ({ label = "" }, narrow) => (narrow && label.length > 44 ? label.replace(" [", "\n[") : label);

function styleAxis(ruler, axis, narrow) {
  Object.assign(ruler, {
    axis_line_color: SOFT, major_tick_line_color: SOFT, minor_tick_line_color: null, major_label_text_color: INK, major_label_text_font_size: "12px",
    axis_label: labelOf(axis, narrow), axis_label_text_color: INK, axis_label_text_font_size: "12px", axis_label_text_font_style: "normal",
  });
  if (axis.scale === "log" && axis.ends[1] / axis.ends[0] < FEW_DECADES) { // plain numbers at 1, 2 and 5
    const ticks = [];
    for (let decade = 10 ** Math.floor(Math.log10(axis.ends[0])); decade <= axis.ends[1]; decade *= 10) ticks.push(decade, 2 * decade, 5 * decade);
    Object.assign(ruler, { ticker: new Bokeh.FixedTicker({ ticks }), formatter: new Bokeh.BasicTickFormatter() });
  }
  if (axis.scale === undefined || axis.scale === "linear") ruler.formatter = new Bokeh.BasicTickFormatter({ power_limit_low: -6 });
  if (!named(axis)) return;
  const places = axis.names ?? [];
  Object.assign(ruler, { ticker: new Bokeh.FixedTicker({ ticks: [...places.keys()] }), major_label_overrides: new Map(places.map((name, i) => [i, name])), axis_line_color: null, major_tick_line_color: null });
}

// On a phone the names of rows and what stands at their other end lie above each row, inside the plot.
function rowsInside(plot, axis, x, width) {
  const at = axis.names.map((_, i) => i), edge = x.ends, notes = axis.notes ?? [], long = (words) => pen.measureText(words).width;
  plot.yaxis.visible = false;
  const names = axis.names.map((name, i) => { // as long as the note beside it leaves room for
    let words = name;
    while (words.length > 4 && long(words) > width - long(notes[i] ?? "") - 44) words = `${words.slice(0, -2)}…`;
    return words;
  });
  for (const [words, place, align] of [[names, edge[0], "left"], [notes, edge[1], "right"]]) {
    if (words.length > 0) plot.text({ x: at.map(() => place), y: at, text: words, text_align: align, text_baseline: "bottom", y_offset: -9, text_color: INK, text_font_size: "12px" });
  }
}

function notesBeside(plot, axis) {
  const ticker = new Bokeh.FixedTicker({ ticks: [...axis.notes.keys()] });
  plot.add_layout(new Bokeh.LinearAxis({
    ticker, major_label_overrides: new Map(axis.notes.map((note, i) => [i, note])), axis_line_color: null, major_tick_line_color: null,
    minor_tick_line_color: null, major_label_text_color: INK, major_label_text_font_size: "12px",
  }), "right");
}

function legendOf(plot, entries, title, narrow, width) {
  const labels = [...entries.keys()];
  if (labels.length === 0) return 0;
  const items = labels.map((value) => new Bokeh.LegendItem({ label: { value: `${value}\u2003` }, renderers: entries.get(value) }));
  const beside = !narrow && ((width > 700 && labels.length > 8) || title !== "");
  const room = Math.max(Math.floor((width - 40) / (6.2 * Math.max(...labels.map((l) => l.length)) + 44)), 1);
  plot.add_layout(new Bokeh.Legend({
    items, click_policy: "hide", background_fill_alpha: 0, border_line_alpha: 0, label_text_color: INK, label_text_font_size: "12px",
    title: title || null, title_text_color: INK, title_text_font_style: "normal", padding: 2, margin: 0, spacing: 1, ncols: beside ? 1 : room,
  }), beside ? "right" : "above");
  return beside ? 0 : 22 * Math.ceil(labels.length / room);
}

function plotOf(figure, part, number, shared, note) {
  const narrow = isNarrow(), { x, y } = part;
  const rows = named(y) ? y.names.length : 0, inside = narrow && rows > 0;
  const range = (axis, flip) => new Bokeh.Range1d({ start: axis.ends[flip ? 1 : 0], end: axis.ends[flip ? 0 : 1] - (flip && inside ? 0.3 : 0) });
  let height = rows ? (inside ? 42 : 26) * rows + 58 : named(x) || part.own ? 280 : [figure.together === "first" || figure.legend_title ? 380 : 270, 190][Math.min(number, 1)];
  if (named(x)) height += 100;
  if (labelOf(x, narrow).includes("\n")) height += 16;
  const tools = narrow ? "reset,save" : "pan,box_zoom,wheel_zoom,reset,save" + (part.marks.some((m) => m.linked) ? ",box_select" : "");
  const plot = Bokeh.Plotting.figure({
    sizing_mode: "stretch_width", height, tools, x_axis_type: x.scale === "log" ? "log" : "linear", y_axis_type: y.scale === "log" ? "log" : "linear",
    x_range: part.own || shared.x === undefined ? range(x, false) : shared.x, y_range: range(y, named(y)),
    toolbar_location: narrow ? null : "right", background_fill_alpha: 0, border_fill_alpha: 0, outline_line_color: null, min_border_left: inside ? 12 : narrow ? 46 : shared.borders.left, min_border_right: inside || narrow ? 8 : shared.borders.right,
  });
  if (!part.own) shared.x ??= plot.x_range;
  if (plot.toolbar) Object.assign(plot.toolbar, { logo: null, autohide: true });
  for (const [ruler, axis] of [[plot.xaxis, x], [plot.yaxis, y]]) styleAxis(ruler, axis, narrow);
  plot.yaxis.axis_label = (y.label ?? "").replace(/(.{1,40})(?: |$)/g, "$1\n").trim(); // along the side, where a long one is cut
  plot.xgrid.grid_line_color = named(x) ? null : GRID;
  plot.ygrid.grid_line_color = named(y) ? null : GRID;
  if (named(x)) Object.assign(plot.xaxis, { major_label_orientation: 0.7 }), (plot.min_width = 320 + 36 * x.names.length);
  if (x.absorption) {
    const ends = (i) => figure.absorption.map((band) => band[i]);
    plot.vstrip({ x0: ends(0), x1: ends(1), fill_color: ABSORPTION, line_color: null, level: "underlay" });
  }
  const entries = new Map(), selected = shared.selected ??= new Bokeh.Selection();
  for (const mark of part.marks) {
    const data = columnsOf(figure, mark);
    const source = new Bokeh.ColumnDataSource(mark.linked ? { data, selected } : { data });
    const drawn = drawMark(plot, mark, source);
    shared.sources.push({ source, drawn });
    for (const one of drawn) one.setv({ visible: mark.hidden !== true, tags: mark.subject === undefined ? [] : [mark.subject, number] });
    const label = mark.legend ?? mark.label;
    if (label) entries.set(label, [...(entries.get(label) ?? []), ...drawn]);
    const tooltips = tips(mark, x, y, data);
    if (drawn.length > 0 && tooltips.length > 0) plot.add_tools(new Bokeh.HoverTool({ tooltips, renderers: drawn.slice(-1), visible: false }));
  }
  for (const [way, location] of part.rules ?? []) {
    plot.add_layout(new Bokeh.Span({ location, dimension: way === "x" ? "height" : "width", line_color: SOFT, line_dash: "dotted" }));
  }
  if (inside) rowsInside(plot, y, x, shared.width);
  else if (y.notes) notesBeside(plot, y);
  // Plots below the first name what it does not have.
  const told = shared.legend ??= new Set(), fresh = [...entries].filter(([label]) => part.own || !told.has(label));
  for (const [label] of fresh) told.add(label);
  plot.height += legendOf(plot, new Map(fresh), figure.legend_title ?? "", narrow, shared.width);
  if (note) plot.add_layout(new Bokeh.Title({ text: note, text_font_style: "normal", text_color: SOFT, text_font_size: "12px" }), "above");
  return plot;
}

// The plots of several subjects drawn over each other: a colour a subject, the dash tells the side.
function together(views) {
  const parts = views[0].parts.map((first, number) => {
    const ends = (way) => views.map((v) => v.parts[number]?.[way].ends ?? first[way].ends);
    const union = (way) => ({ ...first[way], ends: [Math.min(...ends(way).map((e) => e[0])), Math.max(...ends(way).map((e) => e[1]))] });
    const marks = views.flatMap((view, i) => (view.parts[number]?.marks ?? []).map((mark) => ({
      ...mark, colour: CURVES[i % CURVES.length], alpha: 0.12, linked: undefined, subject: view.subject, legend: view.subject,
      label: [view.subject, mark.label].filter(Boolean).join(", "), hidden: i >= FEW,
    })));
    return { ...first, x: union("x"), y: union("y"), marks };
  });
  return { parts, note: "" };
}

const drawnFigures = new Map(); // place -> what is seen there

async function show(place, figure, chosen) {
  const views = figure.views.filter((view) => view.tab === chosen.tab);
  const one = views.find((view) => view.subject === chosen.subject);
  const view = chosen.subject === FIRST ? together(views) : one ?? views[0];
  drawnFigures.get(place)?.view?.remove?.();
  place.replaceChildren();
  const shared = { borders: borders(view.parts), width: place.clientWidth || 900, sources: [] };
  const plots = view.parts.map((part, number) => plotOf(figure, part, number, shared, number === 0 ? view.note : ""));
  for (const [i, plot] of plots.entries()) if (i < plots.length - 1 && !view.parts[i].own && !view.parts[i + 1].own) plot.xaxis.axis_label = "";
  const whole = plots.length === 1 ? plots[0] : new Bokeh.Column({ children: plots, sizing_mode: "stretch_width" });
  drawnFigures.set(place, { figure, chosen: { ...chosen }, view: await Bokeh.Plotting.show(whole, place), plots, sources: shared.sources, narrow: isNarrow() });
  place.dataset.drawn = "yes";
}

// What a reader may choose: a subject or the first few over each other, and a tab.
function choices(place, figure) {
  const of = (values) => [...new Set(values)];
  const tabs = of(figure.views.map((view) => view.tab ?? ""));
  const chosen = { tab: tabs[0], subject: undefined };
  const bar = document.createElement("div");
  bar.className = "choices";
  const choice = (name, options, key) => {
    const label = document.createElement("label"), box = document.createElement("select");
    for (const option of options) box.append(new Option(option));
    label.append(`${name} `, box);
    box.addEventListener("change", () => { chosen[key] = box.value; if (key === "tab") subjects(); redraw(); });
    return [label, box];
  };
  const [subjectLabel, subjectBox] = choice("Subject", [], "subject");
  subjectBox.dataset.chart = figure.section;
  const subjects = () => {
    const names = of(figure.views.filter((view) => (view.tab ?? "") === chosen.tab).map((view) => view.subject ?? ""));
    const several = names.length > 1 && figure.together;
    const options = several === "first" ? [FIRST, ...names] : several ? [...names, FIRST] : names;
    subjectBox.replaceChildren(...options.map((option) => new Option(option)));
    subjectLabel.hidden = options.length < 2;
    if (!options.includes(chosen.subject)) chosen.subject = options[0];
    subjectBox.value = chosen.subject;
  };
  const redraw = () => { if (place.dataset.drawn) show(place, figure, chosen); };
  for (const view of figure.views) { view.tab ??= ""; view.subject ??= ""; }
  subjects();
  if (tabs.length > 1) bar.append(choice("Detector", tabs, "tab")[0]);
  bar.append(subjectLabel);
  if (tabs.length > 1 || !subjectLabel.hidden) place.before(bar);
  return chosen;
}

addEventListener("resize", () => {
  for (const [place, { figure, chosen, narrow }] of drawnFigures) if (narrow !== isNarrow() && place.isConnected) show(place, figure, chosen);
});

// A figure that was fetched, into its place.
async function drawFetched(place, text) {
  const figure = JSON.parse(text);
  await show(place, figure, choices(place, figure));
}

// Other numbers into lines that are drawn, their intervals put away; whether more than the numbers differs is told.
const shapeOf = ({ views }) => JSON.stringify(views.map((v) => v.parts.map((p) => [p.rules, p.x.label, p.x.ends, p.y.label, p.y.scale, p.marks.map((m) => [m.kind, m.label, m.scale])])));
function moveLines(place, figure) {
  const seen = drawnFigures.get(place), marks = figure.views.flatMap((v) => v.parts.flatMap((p) => p.marks));
  if (seen === undefined || shapeOf(seen.figure) !== shapeOf(figure) || marks.some((m) => m.kind !== "line" || m.columns.low !== undefined)) return false;
  marks.forEach((mark, i) => {
    const { source, drawn } = seen.sources[i];
    source.data = columnsOf(figure, mark);
    for (const band of drawn.slice(0, -1)) band.visible = false;
  });
  figure.views[0].parts.forEach((part, i) => seen.plots[i].y_range.setv({ start: part.y.ends[0], end: part.y.ends[1] }));
  seen.figure = figure;
  return true;
}

async function unpackLibrary() {
  for (const part of document.querySelectorAll("script.library")) {
    const packed = new Blob([bytes(part.textContent)]).stream();
    const library = document.createElement("script");
    library.textContent = await new Response(packed.pipeThrough(new DecompressionStream("gzip"))).text();
    document.head.append(library);
  }
}

// One after the other, as they come near the screen; those that are folded when they are unfolded, which brings them
// there.  The others follow while nobody asks for anything, so that they are there when the page is printed.
function drawAll() {
  const left = new Map();
  for (const script of document.querySelectorAll("script.chart")) {
    const place = script.previousElementSibling, figure = JSON.parse(script.textContent);
    left.set(place, [figure, choices(place, figure)]);
  }
  let drawn = null;
  const next = (place) => {
    const content = left.get(place);
    left.delete(place);
    near.unobserve(place);
    // One that cannot be drawn keeps none of the others back.
    return (drawn = (drawn ?? unpackLibrary()).then(() => show(place, ...content)).catch(reportError));
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
// Another page may bring the library and the figures by itself.
if (document.querySelector("script.library") !== null) drawAll();
