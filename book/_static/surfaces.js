// A surface takes the place of its picture: a finger, the mouse and the arrow keys turn it.
addEventListener("DOMContentLoaded", () => {
  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const LIGHT = [-0.57, 0.42, 0.71]; // from the upper left, towards the viewer
  const WAYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

  for (const script of document.querySelectorAll("script.surface")) {
    const { rows, cols, pitch, low, high, unit, heightUnit, tall, note, colors, ...texts } = JSON.parse(script.textContent);
    const heights = new Uint16Array(bytes(texts.heights).buffer); // 0 is a hole
    const kinds = bytes(texts.kinds);
    const paints = colors.map((hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16)));
    const figure = script.closest("figure"), picture = figure.querySelector("img");
    const canvas = Object.assign(document.createElement("canvas"), { tabIndex: 0 });
    canvas.style.aspectRatio = 1 / (0.66 + 0.35 * tall);
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${picture.alt} The arrow keys turn it.`);
    figure.classList.add("surface");
    figure.prepend(canvas);
    figure.querySelector(".caption-text")?.append(" Drag the surface or use the arrow keys to turn it.");
    for (const [name, color] of Object.entries(texts.key).reverse()) {
      const entry = Object.assign(document.createElement("span"), { className: "surface-key", textContent: name });
      entry.style.setProperty("--color", color);
      canvas.after(entry);
    }
    const longest = Math.max(rows, cols) - 1;
    let turn = -0.6, tilt = 0.6;

    const draw = () => {
      const pen = canvas.getContext("2d"), width = canvas.clientWidth;
      [canvas.width, canvas.height] = [width, canvas.clientHeight].map((side) => side * devicePixelRatio);
      pen.scale(devicePixelRatio, devicePixelRatio);
      const [c, s, up, flat] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
      const size = width / 1.7;
      // Where a point is seen whose place is in pixels of the map and whose height is of its span.
      const place = (col, row, z) => {
        const x = (col - (cols - 1) / 2) / longest, y = ((rows - 1) / 2 - row) / longest;
        return [width / 2 + size * (x * c - y * s), (0.36 + 0.15 * tall) * width - size * (flat * (x * s + y * c) + up * tall * (z - 0.5))];
      };
      const points = Array.from(heights, (z, i) => place(i % cols, Math.floor(i / cols), (z - 1) / 65534));
      pen.strokeStyle = pen.fillStyle = getComputedStyle(canvas).color;
      pen.font = "14px sans-serif";
      const corners = [[0, 0], [cols - 1, 0], [cols - 1, rows - 1], [0, rows - 1]];
      const ground = corners.map(([col, row]) => place(col, row, 0));
      pen.beginPath();
      [...ground, ground[0]].forEach((point) => pen.lineTo(...point));
      const left = ground.indexOf(ground.toSorted((one, other) => one[0] - other[0])[0]);
      const top = place(...corners[left], 1);
      pen.stroke();
      if (!Object.keys(texts.key).length) { // the axis of the heights is the bar of their colors
        const bar = pen.createLinearGradient(...ground[left], ...top);
        colors.forEach((color, k) => bar.addColorStop(k / (colors.length - 1), color));
        [pen.strokeStyle, pen.lineWidth] = [bar, 10];
      }
      pen.beginPath();
      pen.moveTo(...ground[left]);
      pen.lineTo(...top);
      pen.stroke();
      pen.lineWidth = 1;
      // From what is far to what is near.
      const inOrder = (count, forth) => Array.from({ length: count - 1 }, (_, k) => (forth ? k : count - 2 - k));
      for (const row of inOrder(rows, c > 0))
        for (const col of inOrder(cols, s < 0)) {
          const i = row * cols + col, face = [i, i + 1, i + cols + 1, i + cols];
          if (!face.every((k) => heights[k])) continue;
          const steep = (tall * longest) / 65534;
          const east = steep * (heights[i + 1] - heights[i]), north = steep * (heights[i] - heights[i + cols]);
          const normal = [-(east * c - north * s), -(east * s + north * c), 1];
          // The light stands with the viewer.
          const lit = normal[0] * LIGHT[0] - normal[1] * LIGHT[1] + LIGHT[2];
          const share = 0.45 + 0.6 * Math.max(0, lit / Math.hypot(...normal));
          pen.fillStyle = pen.strokeStyle = `rgb(${paints[kinds[i]].map((level) => Math.min(255, share * level)).join()})`;
          pen.beginPath();
          face.forEach((k) => pen.lineTo(...points[k]));
          pen.closePath();
          pen.fill();
          pen.stroke(); // or gaps would show between the faces
        }
      pen.fillStyle = getComputedStyle(canvas).color;
      pen.strokeStyle = getComputedStyle(document.body).backgroundColor;
      [pen.lineWidth, pen.lineJoin] = [3, "round"];
      const write = (text, [x, y], side) => {
        pen.textAlign = side;
        const room = pen.measureText(text).width; // a text ends within the canvas
        const at = side === "left" ? Math.min(x, width - 2 - room) : Math.max(x, 2 + room);
        pen.strokeText(text, at, y); // a rim of the page's color, where the surface lies behind
        pen.fillText(text, at, y);
      };
      const near = c > 0 ? rows - 1 : 0, beside = s > 0 ? 0 : cols - 1;
      const [alongX, alongY] = [place((cols - 1) / 2, near, 0), place(beside, (rows - 1) / 2, 0)];
      const side = alongX[0] < alongY[0] ? ["right", "left"] : ["left", "right"];
      const long = (count) => `${Number((pitch * (count - 1)).toPrecision(4))} ${unit}`;
      write(`x: ${long(cols)}`, [alongX[0], alongX[1] + 22], side[0]);
      write(`y: ${long(rows)}`, [alongY[0], alongY[1] + 22], side[1]);
      write(`height ${high} ${heightUnit}`, [top[0], top[1] - 12], "left");
      write(`${low} ${heightUnit}`, [ground[left][0], ground[left][1] + 18], "left");
      write(note, [8, canvas.clientHeight - 6], "left");
    };
    const move = (across, down) => {
      turn += across;
      tilt = Math.max(0.05, Math.min(1.5, tilt + down));
      requestAnimationFrame(draw);
    };
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => event.buttons && move(event.movementX / 100, event.movementY / 100));
    canvas.addEventListener("keydown", (event) => {
      if (!WAYS[event.key]) return;
      event.preventDefault();
      move(...WAYS[event.key].map((step) => step / 10));
    });
    new ResizeObserver(draw).observe(canvas);
    new MutationObserver(draw).observe(document.documentElement, { attributeFilter: ["data-theme"] });
  }
});
