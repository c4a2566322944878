// The sum of the fractions as they are typed; fields of a variant that is not chosen are put away.
const fractions = [...document.querySelectorAll("[data-fraction]")];
const total = document.getElementById("total");
function sum() {
  const value = fractions.reduce((s, box) => s + (parseFloat(box.value) || 0), 0);
  if (total !== null) total.textContent = String(Math.round(value * 1e6) / 1e6);
}
for (const box of fractions) box.addEventListener("input", sum);

for (const set of document.querySelectorAll("fieldset.variants")) {
  const radios = [...set.querySelectorAll(":scope > label > input[type=radio]")];
  const parts = [...set.querySelectorAll(":scope > .variant")];
  const show = () => {
    const chosen = Number(radios.find((r) => r.checked)?.value ?? 0);
    parts.forEach((part, i) => {
      part.hidden = i + 1 !== chosen;
      for (const box of part.querySelectorAll("input, select")) box.disabled = part.hidden;
    });
  };
  for (const radio of radios) radio.addEventListener("change", show);
  show();
}
// A form that came back with mistakes begins at the first of them.
document.querySelector("[aria-invalid]")?.focus();
// Where a value is from changes when somebody writes another.
document.addEventListener("change", (event) => {
  const source = event.target.closest(".field")?.querySelector(".source");
  if (source) source.textContent = "entered";
});
