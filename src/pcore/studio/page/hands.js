// What viser's page does not tell its server: the wheel with Shift held, and whether the browser
// prefers a dark page. Both are told as keys, which have commands. Keys are heard again once a
// widget has been used, and on a telephone the panel opens by a touch.
const press = (key, code) =>
  document.documentElement.dispatchEvent(
    new KeyboardEvent("keydown", { key, code, bubbles: true }),
  );

document.documentElement.classList.add("connected"); // See head.html.

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

  // What was pressed with the mouse keeps the keyboard; keys of commands would go into it.
  const WIDGETS =
    'button, [role="tab"], [role="option"], [role="slider"], input[type="checkbox"]';
  window.addEventListener("click", (event) => {
    if (!event.target.closest?.(WIDGETS)) return;
    setTimeout(() => document.activeElement?.blur(), 0);
  });

  // Who goes from widget to widget with Tab uses them by these keys, which are commands elsewhere.
  const OWN = ["Enter", " ", "ArrowLeft", "ArrowRight"];
  document.body.addEventListener("keydown", (event) => {
    if (OWN.includes(event.key) && event.target.closest(WIDGETS)) event.stopPropagation();
  });
  // Escape closes a window over the page by its last button, which changes nothing.
  window.addEventListener("keydown", (event) => {
    const shown = document.querySelectorAll(".mantine-Modal-content button");
    if (event.key !== "Escape" || !shown.length) return;
    event.stopPropagation();
    shown[shown.length - 1].click();
  }, true);
  // These two step through time; viser, which listens above, would turn its camera.
  document.documentElement.addEventListener("keydown", (event) => {
    if (event.key === "ArrowLeft" || event.key === "ArrowRight") event.stopPropagation();
  });

  // The panel of a narrow window, which viser opens over most of the object.
  const narrow = setInterval(() => {
    const sheet = document.querySelector('.mantine-Paper-root[style*="position: fixed"]');
    const handle = sheet?.querySelector('[style*="cursor: pointer"]');
    if (handle) handle.click();
    if (handle || document.querySelector(".mantine-Tabs-root")) clearInterval(narrow);
  }, 50);

  const style = document.createElement("style");
  style.textContent = STYLE; // The file beside this one; the server puts it before this script.
  document.head.append(style);

  // viser greys the panel when its server is gone, and says nothing.
  const lost = document.createElement("div");
  lost.textContent =
    "The connection is lost. It comes back by itself, unless the server ended: then start it " +
    "again and open the address that it prints. What is not saved is kept.";
  lost.style.cssText =
    "position:fixed;z-index:1000;left:1em;bottom:1em;max-width:26em;padding:0.8em 1em;" +
    "color:#fff;background:#b71c1c;border-radius:4px;font:14px/1.4 sans-serif";
  let wasThere = false; // While the page loads viser shows the same, above what is then to be used.
  setInterval(() => {
    const gone = document.querySelector(".mantine-Loader-root");
    wasThere ||= !gone;
    if (gone && wasThere && !lost.isConnected) document.body.append(lost);
    if (!gone && lost.isConnected) lost.remove();
  }, 500);

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
