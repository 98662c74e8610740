// A film has a button that stops it, and begins stopped for readers who asked for less motion.
addEventListener("DOMContentLoaded", () => {
  const less = matchMedia("(prefers-reduced-motion: reduce)").matches;
  for (const film of document.querySelectorAll("figure.film")) {
    const button = Object.assign(document.createElement("button"), { type: "button", className: "film-button" });
    const show = (moving) => {
      film.classList.toggle("playing", moving);
      film.classList.toggle("stopped", !moving);
      button.textContent = moving ? "Stop the film" : "Play the film";
    };
    button.addEventListener("click", () => show(!film.classList.contains("playing")));
    film.querySelector("figcaption").before(button);
    show(!less);
  }
});
