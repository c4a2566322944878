// Draws each chart of the page, and shows the subject that is chosen; no code is in the charts themselves.
for (const held of document.querySelectorAll("script.chart")) {
  const chart = JSON.parse(held.textContent);
  Bokeh.embed.embed_item(chart.item).then(() => {
    const choice = document.querySelector(`select[data-chart="${chart.item.target_id}"]`);
    if (choice === null) return;
    const plots = Bokeh.documents.find((d) => d.roots().some((r) => r.id === chart.item.root_id));
    const numbers = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
    choice.addEventListener("change", () => {
      const { columns, ranges } = chart.subjects[choice.selectedIndex];
      const entries = Object.entries(columns).map(([name, text]) => [name, numbers(text)]);
      plots.get_model_by_name("spectra").data = Object.fromEntries(entries);
      for (const [name, [start, end]] of Object.entries(ranges))
        plots.get_model_by_name(name).setv({ start, end, reset_start: start, reset_end: end });
    });
  });
}
