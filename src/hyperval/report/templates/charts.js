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

async function draw(chart) {
  await Bokeh.embed.embed_item(chart.item);
  if (chart.subjects.length === 0) return;
  const plots = Bokeh.documents.find((d) => d.roots().some((r) => r.id === chart.item.root_id));
  const show = (number) => {
    const subject = chart.subjects[number];
    plots.get_model_by_name("spectra").data = columns(chart, subject);
    for (const [name, [start, end]] of Object.entries(subject.ranges))
      plots.get_model_by_name(name).setv({ start, end, reset_start: start, reset_end: end });
  };
  show(0);
  const choice = document.querySelector(`select[data-chart="${chart.item.target_id}"]`);
  choice?.addEventListener("change", () => show(choice.selectedIndex));
}

async function drawAll() {
  const packed = new Blob([bytes(document.getElementById("library").textContent)]).stream();
  const library = document.createElement("script");
  library.textContent = await new Response(packed.pipeThrough(new DecompressionStream("gzip"))).text();
  document.head.append(library);
  for (const content of document.querySelectorAll("script.chart")) await draw(JSON.parse(content.textContent));
}
drawAll();
