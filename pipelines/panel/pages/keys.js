// A key presses the button that carries it (data-key), so that both do one thing: keyboards and foot pedals alike.
// Space is for a button that stops something: it works wherever the focus is. Other keys are left to fields of text.
(() => {
  const writing = (element) =>
    element instanceof Element && element.closest("input:not([readonly]), textarea, [contenteditable=true]") !== null;
  const wanted = (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || !event.key) return null;
    if (event.key !== " " && writing(event.target)) return null;
    return document.querySelector(`[data-key="${CSS.escape(event.key.toLowerCase())}"]`);
  };
  const taken = (event) => {
    event.preventDefault();
    event.stopImmediatePropagation();
  };
  // Asked of the server directly, and also while the page is loaded anew: no other part of the page has to be there.
  const stop = () => fetch("/stop", { method: "POST", keepalive: true });
  const stops = () => document.querySelector('meta[name="treewright-space"]') !== null;
  document.addEventListener("click", (event) => {
    if (event.target instanceof Element && event.target.closest("[data-stop]") !== null) stop();
  }, true);
  document.addEventListener("keydown", (event) => {
    if (event.key === " " && stops()) {
      taken(event);
      if (!event.repeat) stop();
      return;
    }
    const button = wanted(event);
    if (button === null) return;
    taken(event);
    if (!event.repeat) button.click();
  }, true);
  // A focused button would be clicked when Space goes up.
  document.addEventListener("keyup", (event) => {
    if (wanted(event) !== null || (event.key === " " && stops())) taken(event);
  }, true);
})();
