// What is too large is told before it is sent.
for (const form of document.querySelectorAll("form[data-most]")) {
  const most = Number(form.dataset.most);
  const words = form.querySelector("output");
  const total = () => [...form.querySelectorAll("input[type=file]")].flatMap((box) => [...box.files]).reduce((s, f) => s + f.size, 0);
  form.addEventListener("change", () => {
    if (words === null) return;
    const size = total();
    words.textContent = `${size.toLocaleString("en")} of at most ${most.toLocaleString("en")} bytes` + (size > most ? ": too large to send" : "");
    form.querySelector("button").disabled = size > most;
  });
  form.addEventListener("submit", (event) => {
    if (total() > most) event.preventDefault();
  });
}
