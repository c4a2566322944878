// How far a run is, and the charts of one that has finished.
const progress = document.getElementById("progress");

async function watch() {
  const answer = await fetch(`/api/v1/runs/${progress.dataset.run}`);
  if (!answer.ok) return;
  const run = await answer.json();
  if (!["waiting", "running"].includes(run.state)) {
    location.reload();
    return;
  }
  document.getElementById("stage").textContent = run.stage;
  document.getElementById("done").value = run.done;
  document.getElementById("left").textContent = run.seconds_left === null ? "" : `about ${run.seconds_left} s left`;
  setTimeout(watch, 400);
}
if (progress !== null) setTimeout(watch, 300);

function figureOf(chart) {
  const figure = document.createElement("figure");
  figure.className = "chart-box";
  const place = document.createElement("div");
  place.id = chart.name;
  place.className = "chart";
  place.setAttribute("role", "group");
  place.setAttribute("aria-label", chart.alt);
  const caption = document.createElement("figcaption");
  caption.textContent = chart.title;
  figure.append(place, caption);
  return figure;
}

async function drawRun() {
  const box = document.getElementById("charts");
  const beside = box.dataset.beside ? `?beside=${box.dataset.beside}` : "";
  const answer = await fetch(`/api/v1/runs/${box.dataset.run}/charts${beside}`);
  const state = document.getElementById("charts-state");
  if (!answer.ok) {
    state.textContent = (await answer.json()).errors[0].message;
    return;
  }
  for (const chart of await answer.json()) {
    box.append(figureOf(chart));
    await drawFetched(document.getElementById(chart.name), chart.content);
  }
  state.remove();
  box.dataset.ready = "yes";
}
if (document.getElementById("charts") !== null) drawRun();
