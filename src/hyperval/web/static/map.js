// A score map: pixels above a threshold that is moved, what was measured at it, the spectrum of a pixel.
const place = document.getElementById("map");
const canvas = document.getElementById("map-canvas");
const slider = document.getElementById("threshold");
let map = null;
let scores = null;

// Thresholds lie as the scores do: the slider's place is a logarithm of the part above it.
function thresholdAt(part) {
  const count = Math.max(1, map.known ** (1 - part));
  let best = map.above[0];
  for (const entry of map.above) if (entry[1] <= count) best = entry;
  return best;
}

function curveAt(curve, threshold) {
  let at = -1;
  curve.threshold.forEach((t, i) => {
    if (t >= threshold && (at < 0 || t <= curve.threshold[at])) at = i;
  });
  if (at >= 0) return { bound: "", pfa: curve.pfa[at], pd: curve.pd[at] };
  // Above its first threshold a curve bounds both, and tells no more.
  at = curve.threshold.indexOf(Math.max(...curve.threshold));
  return { bound: "at most ", pfa: curve.pfa[at], pd: curve.pd[at] };
}

function show() {
  const [threshold] = thresholdAt(Number(slider.value) / 1000);
  const cut = ((threshold - map.low) / (map.high - map.low || 1)) * 65534 + 1;
  const picture = new ImageData(map.width, map.height);
  let alarms = 0;
  scores.forEach((value, i) => {
    const hit = value >= Math.floor(cut);
    alarms += hit && value > 0;
    const grey = Math.round((value / 65535) ** 0.5 * 200);
    picture.data.set(hit && value > 0 ? [255, 190, 0, 255] : [grey, grey, grey, value === 0 ? 0 : 255], 4 * i);
  });
  canvas.getContext("2d").putImageData(picture, 0, 0);
  document.getElementById("threshold-value").textContent = threshold.toPrecision(4);
  const sampled = map.step > 1 ? `, every ${map.step}th line and sample drawn` : "";
  const words = map.curves.map((curve) => {
    const point = curveAt(curve, threshold);
    return `; ${curve.subject} by ${curve.unit}: P_D ${point.bound}${point.pd.toFixed(3)}, P_FA ${point.bound}${point.pfa.toExponential(1)}`;
  });
  document.getElementById("map-words").textContent = `${alarms.toLocaleString("en")} pixels at or above it${sampled}${words.join("")}`;
}

async function spectrum(line, sample) {
  const box = document.getElementById("pixel");
  box.textContent = "The pixel is being read.";
  const answer = await fetch(`/runs/${place.dataset.run}/pixel.json?line=${line}&sample=${sample}`);
  const content = await answer.json();
  box.textContent = answer.ok ? "" : content.errors[0].message;
  if (!answer.ok) return;
  for (const chart of content) {
    box.append(figureOf(chart));
    await draw(JSON.parse(chart.content));
  }
}

async function begin() {
  const answer = await fetch(`/runs/${place.dataset.run}/map.json?name=${encodeURIComponent(place.dataset.name)}`);
  const content = await answer.json();
  if (!answer.ok) {
    document.getElementById("map-words").textContent = content.errors[0].message;
    return;
  }
  map = content;
  scores = new Uint16Array(bytes(map.pixels).buffer);
  canvas.width = map.width;
  canvas.height = map.height;
  canvas.style.width = `${Math.min(map.width * 3, 900)}px`;
  slider.addEventListener("input", show);
  canvas.addEventListener("click", (event) => {
    const at = (offset, size, count) => Math.min(count - 1, Math.floor((offset / size) * count)) * map.step;
    const line = at(event.offsetY, canvas.clientHeight, map.height);
    const sample = at(event.offsetX, canvas.clientWidth, map.width);
    document.getElementById("line").value = line;
    document.getElementById("sample").value = sample;
    spectrum(line, sample);
  });
  document.getElementById("pixel-form").addEventListener("submit", (event) => {
    event.preventDefault();
    spectrum(Number(document.getElementById("line").value), Number(document.getElementById("sample").value));
  });
  show();
}
begin();
