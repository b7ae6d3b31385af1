// A sentence for whatever has `data-tip`: under the pointer, with the keyboard's focus, or touched. Escape hides it.

const WAITS_MS = 400;
const tip = document.getElementById("tip");
let about = null, described = null, awaited = null, timer = null, pointer = "";

function place() {
  const at = about.getBoundingClientRect(), room = document.documentElement.clientWidth;
  const left = Math.max(Math.min(at.left, room - tip.offsetWidth - 8), 8);
  const below = at.bottom + 6 + tip.offsetHeight <= window.innerHeight;
  tip.style.left = `${left}px`;
  tip.style.top = `${below ? at.bottom + 6 : Math.max(at.top - tip.offsetHeight - 6, 4)}px`;
}

function show(element, focused) {
  about = element;
  tip.textContent = element.dataset.tip.replace(/^./, (letter) => letter.toUpperCase());
  tip.hidden = false;
  place();
  described = focused;
  awaited = null;
  described?.setAttribute("aria-describedby", "tip");
}

function hide() {
  clearTimeout(timer);
  described?.removeAttribute("aria-describedby");
  about = described = awaited = null;
  tip.hidden = true;
}

function soon(element, focused) {
  clearTimeout(timer);
  awaited = focused;
  timer = setTimeout(() => {
    if (element.isConnected && element.dataset.tip) show(element, focused);
  }, WAITS_MS);
}

function owner(target) {
  const found = target.closest?.("[data-tip]");
  return found?.dataset.tip ? found : null;
}

// What scrolls or grows under a pointer at rest is not pointed at.
document.addEventListener("pointerover", (event) => {
  const before = pointer;
  pointer = `${event.screenX} ${event.screenY}`;
  if (pointer === before) return undefined;
  if (event.pointerType === "touch" || tip.contains(event.target)) return clearTimeout(timer);
  const found = owner(event.target);
  if (found === about && found) return clearTimeout(timer);
  if (about && !described) hide();
  if (found && !event.buttons) soon(found, null);
  return undefined;
});
document.addEventListener("focusin", (event) => {
  const found = owner(event.target);
  hide();
  if (found && event.target.matches(":focus-visible")) soon(found, event.target);
});
document.addEventListener("focusout", hide);
document.addEventListener("input", hide);
document.addEventListener("pointerdown", (event) => { if (!tip.contains(event.target)) hide(); });
document.addEventListener("click", (event) => {
  const word = event.target.closest?.(".term");
  if (word) show(word, word);
});
// The focus brings its element into view: the scrolling that follows must not take that element's tip.
document.addEventListener("scroll", () => {
  if (described) place();
  else if (!awaited) hide();
}, true);
document.addEventListener("keydown", (event) => { if (event.key === "Escape") hide(); });
