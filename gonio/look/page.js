"use strict";
// What every page does: folds and plots keep their state in the address, paper shows all folds, terms are explained.
(() => {
  document.documentElement.classList.add("js");
  const folds = [...document.querySelectorAll("details[id]")];
  const at_first = new Map(folds.map((fold) => [fold, fold.open]));

  // --- the address -------------------------------------------------------------------------------------------------
  const held = () => new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
  function hold(key, value) {
    const now = held();
    if (value === "") now.delete(key); else now.set(key, value);
    const text = now.toString();
    if (text === held().toString()) return;
    history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
  }
  const changed = () => folds.filter((fold) => fold.open !== at_first.get(fold)).map((fold) => fold.id).join(" ");
  for (const id of (held().get("folds") || "").split(" ")) {
    const fold = document.getElementById(id);
    if (at_first.has(fold)) fold.open = !at_first.get(fold);
  }
  for (const viewer of (window.gonio && window.gonio.viewers) || []) {
    const key = viewer.root.id;
    viewer.restore(held().get(key) || "");
    viewer.keep = (state) => hold(key, state);
  }

  // --- links lead into folds ----------------------------------------------------------------------------------------
  function unfold(node) {
    for (let one = node && node.closest("details"); one; one = one.parentElement.closest("details")) one.open = true;
  }
  function named(name) {
    try { return document.getElementById(decodeURIComponent(name)); } catch { return null; } // no name of ours: "%"
  }
  function follow() {
    const node = location.hash.includes("=") ? null : named(location.hash.slice(1));
    if (!node) return;
    unfold(node);
    node.scrollIntoView();
  }
  addEventListener("hashchange", follow);
  follow();

  // --- paper --------------------------------------------------------------------------------------------------------
  let closed = null;
  addEventListener("beforeprint", () => {
    closed = closed || folds.filter((fold) => !fold.open);
    for (const fold of closed) fold.open = true;
  });
  addEventListener("afterprint", () => {
    for (const fold of closed || []) fold.open = false;
    closed = null;
  });
  for (const fold of folds) fold.addEventListener("toggle", () => closed === null && hold("folds", changed()));

  // --- terms --------------------------------------------------------------------------------------------------------
  const box = document.createElement("div");
  box.className = "meaning";
  box.setAttribute("role", "tooltip");
  box.hidden = true;
  document.body.append(box);
  function tell(term) {
    box.textContent = term.dataset.meaning;
    box.hidden = false;
    const at = term.getBoundingClientRect(), width = document.documentElement.clientWidth;
    box.style.left = `${Math.max(8, Math.min(at.left, width - box.offsetWidth - 8))}px`;
    const below = at.bottom + 6, above = at.top - box.offsetHeight - 6;
    box.style.top = `${below + box.offsetHeight > innerHeight && above > 0 ? above : below}px`;
  }
  const hush = () => { box.hidden = true; };
  const known = new Map();
  for (const term of document.querySelectorAll(".term")) {
    known.set(term.textContent.trim(), term.title);
    term.dataset.meaning = term.title;
    term.setAttribute("aria-description", term.title);
    term.removeAttribute("title");
    for (const event of ["mouseenter", "focus", "click"]) term.addEventListener(event, () => tell(term));
    for (const event of ["mouseleave", "blur"]) term.addEventListener(event, hush);
  }
  if (known.size) { // no paper can be touched: there they stand at the end
    const put = (name, text, into) => into.appendChild(Object.assign(document.createElement(name), { textContent: text }));
    const last = document.createElement("section");
    last.className = "terms";
    put("h3", "Terms", last);
    const list = put("dl", "", last);
    list.className = "facts";
    for (const [name, meaning] of [...known].sort(([a], [b]) => a.localeCompare(b))) {
      put("dt", name, list);
      put("dd", meaning, list);
    }
    document.querySelector("main > footer").before(last);
  }
  addEventListener("scroll", hush, { passive: true });
  addEventListener("keydown", (event) => event.key === "Escape" && hush());
})();
