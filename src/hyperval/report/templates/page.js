// Tables that sort and filter, and links from a cell of the matrix to its evidence; without scripts all is still there.
for (const table of document.querySelectorAll("table.rows")) {
  const body = table.tBodies[0];
  const rows = [...body.rows];
  if (rows.length < 2) continue;
  const reason = table.tHead.rows[0].cells.length - 1;
  let above = "";
  const reasons = rows.map((row) => {
    const text = row.cells[reason].textContent;
    return (above = text === "as above" ? above : text);
  });
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      rows.forEach((row, i) => (row.cells[reason].textContent = reasons[i]));
      const key = (row) => row.cells[column].textContent.replace("−", "-");
      const sign = up ? 1 : -1;
      const sorted = [...rows].sort((a, b) => {
        const [x, y] = [parseFloat(key(a)), parseFloat(key(b))];
        const order = Number.isNaN(x) || Number.isNaN(y) ? key(a).localeCompare(key(b)) : x - y;
        return sign * order;
      });
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      body.append(...sorted);
    });
  });
  if (rows.length < 6) continue;
  const label = document.createElement("label");
  const box = Object.assign(document.createElement("input"), { type: "search" });
  const count = document.createElement("output");
  label.append("Filter ", box, " ", count);
  label.className = "filter";
  table.before(label);
  box.addEventListener("input", () => {
    const wanted = box.value.toLowerCase();
    let shown = 0;
    rows.forEach((row, i) => {
      row.hidden = !`${row.textContent} ${reasons[i]}`.toLowerCase().includes(wanted);
      shown += !row.hidden;
    });
    count.textContent = wanted ? `${shown} of ${rows.length}` : "";
  });
}

const slug = (text) => text.replace(/[^A-Za-z0-9]+/g, "-").replace(/^-|-$/g, "");

// The chart that shows what an anchor such as "e-radiance-grass" is about, its subject chosen.
function chartOf(id) {
  for (const choice of document.querySelectorAll("select[data-chart]")) {
    const product = choice.dataset.chart;
    const at = [...choice.options].findIndex((option) => slug(`e-${product}-${option.text}`) === id);
    if (at < 0) continue;
    choice.selectedIndex = at;
    choice.dispatchEvent(new Event("change"));
    return choice.closest("figure");
  }
  return null;
}

function follow(preferChart) {
  const id = decodeURIComponent(location.hash.slice(1));
  if (!id) return;
  const row = document.getElementById(id);
  for (let at = row; at; at = at.parentElement) if (at.tagName === "DETAILS") at.open = true;
  const chart = chartOf(id);
  (preferChart && chart ? chart : row)?.scrollIntoView();
}
addEventListener("hashchange", () => follow(true));
addEventListener("load", () => follow(true));
