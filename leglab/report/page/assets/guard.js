"use strict";
// No policy forbids a page to open windows, or to go elsewhere by a link or a script: this does.
(() => {
  function isElsewhere(address) {
    const target = new URL(address, location.href);
    if (target.protocol === "blob:" || target.protocol === "data:") return false; // files that the page saves
    return target.protocol !== location.protocol || target.host !== location.host;
  }

  function stay(event) {
    const link = event.target instanceof Element ? event.target.closest("a, area") : null;
    const href = link && link.href;
    if (href && isElsewhere(href.baseVal === undefined ? href : href.baseVal)) event.preventDefault();
  }

  Object.defineProperty(window, "open", { value: () => null, writable: false, configurable: false });
  addEventListener("click", stay, true);
  addEventListener("auxclick", stay, true);
  if (window.navigation) {
    navigation.addEventListener("navigate", (event) => {
      if (event.cancelable && isElsewhere(event.destination.url)) event.preventDefault();
    });
  }
})();
