// The sum of the fractions as they are typed; fields of a variant that is not chosen are put away.
const fractions = [...document.querySelectorAll("[data-fraction]")];
const total = document.getElementById("total");
function sum() {
  const value = fractions.reduce((s, box) => s + (parseFloat(box.value) || 0), 0);
  if (total === null) return;
  total.textContent = String(Math.round(value * 1e6) / 1e6);
  total.parentElement.hidden = false;
}
sum();
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
// A form that came back with mistakes begins at the first of them; the list of mistakes leads to the others.
function reach(box) {
  for (let part = box.closest("details"); part !== null; part = part.parentElement.closest("details")) part.open = true;
  box.focus();
}
const first = document.querySelector("[aria-invalid]:enabled");
if (first !== null) reach(first);
for (const link of document.querySelectorAll("#mistakes a")) {
  link.addEventListener("click", (event) => {
    const box = document.querySelector(`[name="${CSS.escape(link.dataset.field)}"]:enabled`);
    if (box === null) return;
    event.preventDefault();
    reach(box);
  });
}
// What differs from where the form began is marked; sections count what is changed in them.
const wasChanged = (box) =>
  box.type === "checkbox" || box.type === "radio" ? box.checked !== box.defaultChecked
  : box.options ? [...box.options].some((o) => o.selected !== o.defaultSelected) && (box.selectedIndex > 0 || [...box.options].some((o) => o.defaultSelected))
  : box.value !== box.defaultValue;
function isChanged(part) {
  if (part.matches(".field")) return "changed" in part.dataset || [...part.querySelectorAll("input:enabled, select:enabled")].some(wasChanged);
  return [...part.querySelectorAll(":scope > label > input")].some(wasChanged);
}
function count() {
  for (const words of document.querySelectorAll(".changed")) {
    const parts = [...words.closest("details, form").querySelectorAll(".field, fieldset.variants")];
    const changes = parts.filter((part) => part.closest("[hidden]") === null && isChanged(part)).length;
    words.textContent = `${changes} changed`;
    words.hidden = changes === 0;
  }
}
document.addEventListener("input", (event) => {
  const field = event.target.closest(".field");
  field?.classList.toggle("touched", isChanged(field));
  count();
});
