// A small window over a link to a formula, figure, source, term or claim shows what it leads to.
addEventListener("DOMContentLoaded", () => {
  const root = new URL(document.documentElement.dataset.content_root ?? "./", location.href);
  const DELAY = 250; // ms: who only passes over a link is not disturbed
  const window_ = Object.assign(document.createElement("div"), { id: "link-preview", hidden: true });
  window_.setAttribute("role", "tooltip");
  document.body.append(window_);
  let timer, asked, loading;

  // The previews are one script, fetched with the first of them.
  const load = () =>
    (loading ??= new Promise((done) => {
      const src = new URL("_static/preview_data.js", root);
      document.head.append(Object.assign(document.createElement("script"), { src, onload: done }));
    }));

  const place = (link) => {
    const box = link.getBoundingClientRect();
    const { offsetWidth: width, offsetHeight: height } = window_;
    const left = Math.max(8, Math.min(box.left, innerWidth - width - 8));
    const below = box.bottom + 6 + height < innerHeight || box.top < height + 6;
    window_.style.left = `${left + scrollX}px`;
    window_.style.top = `${(below ? box.bottom + 6 : box.top - height - 6) + scrollY}px`;
  };

  const hide = () => {
    clearTimeout(timer);
    asked?.removeAttribute("aria-describedby");
    asked = undefined;
    window_.hidden = true;
  };

  const show = async (link) => {
    asked = link;
    await load();
    const address = link.href.slice(root.href.length);
    const text = linkPreviews[decodeURI(address)];
    if (!text || asked !== link) return;
    window_.innerHTML = text;
    for (const image of window_.querySelectorAll("img")) {
      image.onload = () => asked === link && place(link);
      image.src = new URL(image.getAttribute("src"), root);
    }
    window_.hidden = false;
    await window.MathJax?.typesetPromise?.([window_]);
    if (asked !== link) return;
    link.setAttribute("aria-describedby", window_.id);
    place(link);
  };

  const previewed = (event) => event.target.closest?.("article a.internal[href*='#']");
  document.addEventListener("pointerover", (event) => {
    const link = previewed(event);
    if (event.pointerType === "touch" || !link || link === asked) return;
    hide();
    timer = setTimeout(show, DELAY, link);
  });
  document.addEventListener("pointerout", (event) => previewed(event) && hide());
  document.addEventListener("focusin", (event) => {
    const link = previewed(event);
    if (link?.matches(":focus-visible")) show(link);
  });
  document.addEventListener("focusout", hide);
  document.addEventListener("keydown", (event) => event.key === "Escape" && hide());
});
