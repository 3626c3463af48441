// What viser's page does not tell its server: the wheel with Shift held, and whether the browser
// prefers a dark page. Both are told as keys, which have commands. Keys are heard again once a list
// or a box has been used, and fields of three numbers show all their decimals.
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

  // What was chosen or ticked keeps the keyboard; keys of commands would go into it.
  window.addEventListener("click", (event) => {
    if (!event.target.closest?.('[role="option"], input[type="checkbox"]')) return;
    setTimeout(() => document.activeElement?.blur(), 0);
  });

  // Steppers of three numbers in a row cover the last decimals.
  const style = document.createElement("style");
  style.textContent = `
    .mantine-Flex-root > .mantine-NumberInput-root:nth-of-type(n):not(:only-child) {
      .mantine-NumberInput-section { display: none; }
      .mantine-NumberInput-input { padding-inline: 0.3em !important; }
    }`;
  document.head.append(style);

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
