// A click on a figure opens it over the page with its caption. The wheel, two fingers, + and − make
// it larger; Esc, a click and the way back close it.
addEventListener("DOMContentLoaded", () => {
  const make = (tag, properties, ...children) => {
    const one = Object.assign(document.createElement(tag), properties);
    one.append(...children);
    return one;
  };
  // Paper is white.
  const { dataset } = document.documentElement;
  let theme;
  addEventListener("beforeprint", () => ([theme, dataset.theme] = [dataset.theme, "light"]));
  addEventListener("afterprint", () => (dataset.theme = theme));

  const MOST = 16; // times the size that fits
  const view = make("div", { className: "figure-view", tabIndex: 0 });
  const caption = make("div", { className: "figure-told" });
  const close = make("button", { type: "button", textContent: "Close" });
  const dialog = make("dialog", { id: "figure-dialog" }, view, caption, close);
  view.setAttribute("role", "group");
  document.body.append(dialog);
  let size, shape, drag, fingers;

  // Make the picture larger about a point of the view; without one about its middle.
  const zoom = (factor, x = view.clientWidth / 2, y = view.clientHeight / 2) => {
    const across = (view.scrollLeft + x) / view.scrollWidth, down = (view.scrollTop + y) / view.scrollHeight;
    size = Math.max(1, Math.min(MOST, size * factor));
    const fit = Math.min(view.clientWidth, view.clientHeight * shape);
    for (const picture of view.children) picture.style.width = `${size * fit}px`;
    view.scrollTo(across * view.scrollWidth - x, down * view.scrollHeight - y);
  };

  document.addEventListener("click", (event) => {
    const link = event.target.closest?.("a.enlarge");
    if (!link || event.ctrlKey || event.metaKey || event.shiftKey) return;
    event.preventDefault();
    const pictures = [...link.querySelectorAll("img")];
    const shown = pictures.map((one) => one.getBoundingClientRect()).find((box) => box.width);
    [size, shape] = [1, shown.width / shown.height];
    view.replaceChildren(...pictures.map((one) => one.cloneNode()));
    view.setAttribute("aria-label", pictures[0].alt);
    const text = link.closest("figure").querySelector(".caption-text");
    caption.replaceChildren(...text.cloneNode(true).childNodes);
    dialog.showModal();
    view.focus();
    zoom(1);
    history.pushState({ figure: true }, "");
  });
  close.addEventListener("click", () => dialog.close());
  dialog.addEventListener("close", () => history.state?.figure && history.back());
  addEventListener("popstate", () => dialog.close());
  dialog.addEventListener("click", (event) => {
    if (!drag?.moved && !event.target.closest("a")) dialog.close();
  });
  dialog.addEventListener("keydown", ({ key }) => {
    if (key === "Escape") dialog.close(); // the theme keeps it from the browser
    if (key === "+" || key === "=") zoom(1.25);
    if (key === "-") zoom(0.8);
  });
  view.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = view.getBoundingClientRect();
    zoom(Math.exp(-event.deltaY / 400), event.clientX - box.left, event.clientY - box.top);
  });
  // A mouse moves the picture; a finger scrolls it anyway.
  view.addEventListener("pointerdown", ({ clientX: x, clientY: y }) => (drag = { x, y, moved: false }));
  view.addEventListener("pointermove", ({ buttons, pointerType, clientX: x, clientY: y }) => {
    if (!buttons || pointerType !== "mouse" || Math.hypot(x - drag.x, y - drag.y) < 3) return;
    view.scrollBy(drag.x - x, drag.y - y);
    drag = { x, y, moved: true };
  });
  view.addEventListener("touchmove", (event) => {
    if (event.touches.length < 2) return;
    event.preventDefault(); // the page itself stays
    const [one, two] = event.touches, box = view.getBoundingClientRect();
    const apart = Math.hypot(one.clientX - two.clientX, one.clientY - two.clientY);
    zoom(apart / (fingers ?? apart), (one.clientX + two.clientX) / 2 - box.left, (one.clientY + two.clientY) / 2 - box.top);
    fingers = apart;
  }, { passive: false });
  view.addEventListener("touchend", () => (fingers = undefined));
});
