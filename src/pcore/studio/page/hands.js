// What viser's page does not tell its server: the wheel with Shift held, and whether the browser
// prefers a dark page. Both are told as keys, which have commands.
const press = (key, code) =>
  document.documentElement.dispatchEvent(
    new KeyboardEvent("keydown", { key, code, bubbles: true }),
  );

// Commands are there once the page has shown them. D is taken: viser moves its camera with it.
if (window.matchMedia("(prefers-color-scheme: dark)").matches) {
  setTimeout(() => press("t", "KeyT"), 500);
}

if (!window.pcoreHands) {
  window.pcoreHands = true;

  // The corners of viser's splats are flat, so that three.js finds no sphere around them and says so.
  // They are drawn wherever they are.
  const error = console.error;
  console.error = (...said) => {
    const flat = said[1]?.attributes?.sortedIndex && said[1].boundingSphere;
    if (flat && Number.isNaN(flat.radius)) flat.radius = Infinity;
    else error(...said);
  };

  let last = 0;
  window.addEventListener(
    "wheel",
    (event) => {
      if (!event.shiftKey || event.target.tagName !== "CANVAS") return;
      event.preventDefault();
      event.stopImmediatePropagation();
      // Some browsers turn the wheel sideways while Shift is held.
      const way = event.deltaY || event.deltaX;
      if (way === 0 || event.timeStamp < last + 80) return;
      last = event.timeStamp;
      if (way < 0) press("PageUp", "PageUp");
      else press("PageDown", "PageDown");
    },
    { capture: true, passive: false },
  );
}
