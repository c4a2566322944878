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

// The part of some scores that lies at a threshold or above, where all of them that do are known.
function partAbove(scores, count, threshold) {
  const above = scores.filter((s) => s >= threshold).length;
  return scores.length > 0 && (above < scores.length || above === count) ? above / count : null;
}

// A point of the curve, between two of its own; above its first threshold it bounds both, and tells no more.
function pointAt(curve, threshold) {
  const after = curve.threshold.findIndex((t) => t < threshold);
  if (after === 0) return { bound: "at most ", pfa: curve.pfa[0], pd: curve.pd[0] };
  const i = after < 0 ? curve.threshold.length - 1 : after;
  const j = Math.max(i - 1, 0);
  const [high, low] = [curve.threshold[j], curve.threshold[i]];
  const part = after < 0 || high === low ? 1 : (high - threshold) / (high - low);
  return { bound: after < 0 && threshold < low ? "at least " : "", pfa: curve.pfa[j] * (curve.pfa[i] / curve.pfa[j]) ** part, pd: curve.pd[j] + (curve.pd[i] - curve.pd[j]) * part };
}

function curveAt(curve, threshold) {
  const point = pointAt(curve, threshold);
  const pd = partAbove(curve.target_scores, curve.n_target, threshold);
  const pfa = partAbove(curve.background_scores, curve.n_background, threshold);
  const bounds = { pd: pd === null ? point.bound : "", pfa: pfa === null ? point.bound : "" };
  return { bounds, pd: pd ?? point.pd, pfa: pfa ?? point.pfa };
}

function showThreshold() {
  const [threshold, alarms] = thresholdAt(Number(slider.value) / 1000);
  const cut = ((threshold - map.low) / (map.high - map.low || 1)) * 65534 + 1;
  const picture = new ImageData(map.width, map.height);
  scores.forEach((value, i) => {
    const hit = value >= Math.floor(cut);
    const grey = Math.round((value / 65535) ** 0.5 * 200);
    picture.data.set(hit && value > 0 ? [255, 190, 0, 255] : [grey, grey, grey, value === 0 ? 0 : 255], 4 * i);
  });
  canvas.getContext("2d").putImageData(picture, 0, 0);
  document.getElementById("threshold-value").textContent = threshold.toPrecision(4);
  const sampled = map.step > 1 ? `, every ${map.step}th line and sample drawn` : "";
  const words = map.curves.map((curve) => {
    const point = curveAt(curve, threshold);
    return `; ${curve.subject} by ${curve.unit}: P_D ${point.bounds.pd}${point.pd.toFixed(3)}, P_FA ${point.bounds.pfa}${point.pfa.toExponential(1)}`;
  });
  document.getElementById("map-words").textContent = `${alarms.toLocaleString("en")} ${alarms === 1 ? "pixel" : "pixels"} at or above it${sampled}${words.join("")}`;
}

async function spectrum(line, sample) {
  const box = document.getElementById("pixel");
  box.textContent = "Reading the pixel.";
  const answer = await fetch(`/runs/${place.dataset.run}/pixel.json?line=${line}&sample=${sample}`);
  const content = await answer.json();
  box.textContent = answer.ok ? "" : content.errors[0].message;
  if (!answer.ok) return;
  for (const chart of content) {
    box.append(figureOf(chart));
    await drawFetched(document.getElementById(chart.name), chart.content);
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
  slider.addEventListener("input", showThreshold);
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
  showThreshold();
}
begin();
