"use strict";
// Tables: a click on a header sorts by its column, numbers by their value.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const falling = head.getAttribute("aria-sort") === "ascending";
      heads.forEach((each) => each.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", falling ? "descending" : "ascending");
      const value = (row) => row.cells[column]?.textContent ?? "";
      const compare = (a, b) => {
        const [x, y] = [parseFloat(value(a)), parseFloat(value(b))];
        return Number.isNaN(x) || Number.isNaN(y) ? value(a).localeCompare(value(b)) : x - y;
      };
      const rows = [...table.tBodies[0].rows].sort(compare);
      table.tBodies[0].append(...(falling ? rows.reverse() : rows));
    });
  });
}

// Scenes: the drawing becomes one that is turned by pointer and arrow keys, and enlarged by + and -.
for (const box of document.querySelectorAll(".turning")) {
  const scene = JSON.parse(box.querySelector("script").textContent);
  const still = box.querySelector("svg");
  const canvas = document.createElement("canvas");
  const [width, height] = [900, 520];
  const sharp = window.devicePixelRatio || 1;
  [canvas.width, canvas.height] = [width * sharp, height * sharp];
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${box.dataset.title}. Arrow keys turn it, plus and minus change its size.`);
  const view = { turn: (-35 * Math.PI) / 180, tilt: (28 * Math.PI) / 180, size: 1 };
  const colours = new Map();
  const colour = (name) => {
    if (!colours.has(name)) {
      const probe = document.createElementNS("http://www.w3.org/2000/svg", "path");
      probe.setAttribute("class", `scene ${name}`);
      still.append(probe);
      const style = getComputedStyle(probe);
      colours.set(name, [style.stroke, parseFloat(style.strokeOpacity), style.strokeDasharray]);
      probe.remove();
    }
    return colours.get(name);
  };
  const label = (pen, line, place, letter) => {
    const at = [...Array(line.p.length / 3).keys()].map((i) => place(line.p, i));
    const size = [pen.measureText(line.t).width, letter];
    const [x, y] = [0, 1].map((k) => {
      const [low, high] = [Math.min(...at.map((each) => each[k])), Math.max(...at.map((each) => each[k]))];
      const beside = line.s[k] > 0 ? high + line.g : low - line.g - size[k];
      const corner = line.s[k] ? beside : (low + high - size[k]) / 2;
      return Math.max(0, Math.min([width, height][k] - size[k], corner));
    });
    pen.globalAlpha = 1;
    pen.setLineDash([]);
    pen.strokeStyle = getComputedStyle(canvas).backgroundColor;
    pen.lineWidth = letter / 3;
    pen.lineJoin = "round";
    pen.strokeText(line.t, x, y + 0.8 * letter);
    pen.fillStyle = getComputedStyle(document.body).color;
    pen.fillText(line.t, x, y + 0.8 * letter);
  };
  const draw = () => {
    const pen = canvas.getContext("2d");
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    pen.clearRect(0, 0, width, height);
    const scale = view.size * scene.scale;
    const [c, s, ct, st] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.tilt), Math.sin(view.tilt)];
    const place = (p, i) => {
      const [x, y, z] = [0, 1, 2].map((k) => p[3 * i + k] - scene.centre[k]);
      return [width / 2 + scale * (c * x - s * y), height / 2 - scale * (ct * z + st * (s * x + c * y))];
    };
    pen.lineWidth = 1.3;
    const letter = Math.max(12, (11 * width) / (canvas.clientWidth || width)); // as large on a narrow screen
    pen.font = `${letter}px system-ui, sans-serif`;
    for (const line of scene.lines) {
      const [stroke, opacity, dash] = colour(line.c);
      pen.strokeStyle = stroke;
      pen.globalAlpha = opacity;
      pen.setLineDash(dash === "none" ? [] : [4, 3]);
      pen.beginPath();
      for (let i = 0; i < line.p.length / 3; i++) pen[i ? "lineTo" : "moveTo"](...place(line.p, i));
      pen.stroke();
    }
    for (const line of scene.lines) if (line.t) label(pen, line, place, letter);
  };
  const change = (turn, tilt, size) => {
    view.turn += turn;
    view.tilt = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, view.tilt + tilt));
    view.size = Math.min(20, Math.max(0.2, view.size * size));
    draw();
  };
  const keys = { ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1], "+": [0, 0, 1.2], "-": [0, 0, 1 / 1.2] };
  canvas.addEventListener("keydown", (event) => {
    if (event.key in keys) {
      change(...keys[event.key]);
      event.preventDefault();
    }
  });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons) change(event.movementX / 150, event.movementY / 150, 1);
  });
  canvas.addEventListener("wheel", (event) => {
    if (event.ctrlKey) {
      change(0, 0, Math.exp(-event.deltaY / 400));
      event.preventDefault();
    }
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    colours.clear();
    draw();
  });
  still.style.display = "none";
  box.append(canvas);
  colours.clear();
  still.style.display = "";
  draw();
  still.style.display = "none";
  window.addEventListener("resize", draw);
}
