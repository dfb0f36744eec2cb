"use strict";
// Scenes in three dimensions: the drawing without scripts becomes one that is turned. three.js is unpacked when the
// first one comes into view; one renderer draws them all, since browsers allow few, and each canvas gets a copy.
let renderer;
const unpackLibrary = async () => {
  const packed = Uint8Array.from(atob(document.getElementById("three").textContent), (c) => c.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(unpacked).text();
  document.head.append(script);
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("webgl2", { alpha: true, antialias: true, failIfMajorPerformanceCaveat: false });
  return context && new THREE.WebGLRenderer({ canvas, context, alpha: true });
};
const colourOf = (name) => new THREE.Color(getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
const newElement = (tag, properties) => Object.assign(document.createElement(tag), properties);
const VIEWS = { Whole: [0.51, -0.72, 0.47], Front: [1, 0, 0], Side: [0, 1, 0], Top: [0, -1e-3, 1] };
const KEYS = {
  ArrowLeft: ["rotateLeft", 0.1], ArrowRight: ["rotateLeft", -0.1], ArrowUp: ["rotateUp", 0.1], ArrowDown: ["rotateUp", -0.1],
  "+": ["dollyIn", 1 / 1.2], "-": ["dollyOut", 1 / 1.2],
};

const objectOf = (line, kinds) => {
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(line.p, 3));
  const dashed = kinds[line.c].dashed;
  const material = dashed ? new THREE.LineDashedMaterial({ dashSize: kinds.dash, gapSize: kinds.dash }) : new THREE.LineBasicMaterial();
  const object = new THREE.Line(geometry, material).computeLineDistances();
  if (kinds[line.c].filled) {
    const face = new THREE.BufferGeometry().setAttribute("position", geometry.getAttribute("position")).setIndex([0, 1, 2, 0, 2, 3]);
    object.add(new THREE.Mesh(face, new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.12, side: THREE.DoubleSide, depthWrite: false })));
  }
  return Object.assign(object, { userData: line });
};
const cloudOf = (cloud, count) => {
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(cloud.p, 3));
  geometry.setAttribute("color", new THREE.Float32BufferAttribute(3 * count, 3));
  const material = new THREE.PointsMaterial({ size: 2, sizeAttenuation: false, vertexColors: true });
  return Object.assign(new THREE.Points(geometry, material), { userData: cloud });
};
const gridOf = (low, high, step) => {
  const [x0, y0] = [0, 1].map((k) => step * Math.floor(low[k] / step));
  const [x1, y1] = [0, 1].map((k) => step * Math.ceil(high[k] / step));
  const points = [];
  for (let x = x0; x < x1 + step / 2; x += step) points.push(x, y0, low[2], x, y1, low[2]);
  for (let y = y0; y < y1 + step / 2; y += step) points.push(x0, y, low[2], x1, y, low[2]);
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  return Object.assign(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial()), { userData: { c: "grid" } });
};

const openScene = (box) => {
  const { lines, clouds, kinds, collections } = JSON.parse(box.querySelector("script").textContent);
  const all = lines.filter(({ k, a }) => k === undefined || a).flatMap((each) => each.p);
  const bound = (pick) => [0, 1, 2].map((k) => all.reduce((found, value, i) => (i % 3 === k ? pick(found, value) : found), all[k]));
  const [low, high] = [bound(Math.min), bound(Math.max)];
  const centre = new THREE.Vector3(...low.map((value, k) => (value + high[k]) / 2));
  const radius = Math.max(0.05, new THREE.Vector3(...low).distanceTo(centre));
  const step = [1, 2, 5, 10].map((m) => m * 10 ** Math.floor(Math.log10(radius / 5))).find((size) => size >= radius / 5);
  kinds.dash = radius / 60;

  const scene = new THREE.Scene();
  scene.add(gridOf(low, high, step), ...lines.map((line) => objectOf(line, kinds)), ...clouds.map((cloud) => cloudOf(cloud, cloud.v.length)));
  const camera = new THREE.PerspectiveCamera(35, 1, radius / 100, 60 * radius);
  camera.up.set(0, 0, 1);
  const canvas = newElement("canvas", { tabIndex: 0 });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${box.dataset.title}. Arrow keys turn it, plus and minus change its size.`);
  canvas.addEventListener("wheel", (event) => event.ctrlKey || event.stopImmediatePropagation(), { capture: true });
  const tools = newElement("div", { className: "tools" });
  box.querySelector("svg").before(tools, canvas);
  box.classList.add("opened");
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.target.copy(centre);
  canvas.style.touchAction = "pan-y"; // a finger that moves down scrolls the page

  const hidden = new Set();
  let chosen = -1; // all collections
  const isShown = ({ c, k, a }) => !hidden.has(c) && (k === undefined || (chosen < 0 ? a : k === chosen));
  const takeColours = () => {
    const [good, bad] = [colourOf("blue"), colourOf("red")];
    for (const object of scene.children) {
      const { c, v } = object.userData;
      if (v) {
        const colours = object.geometry.getAttribute("color");
        v.forEach((value, i) => colours.setXYZ(i, ...good.clone().lerp(bad, value).toArray()));
        colours.needsUpdate = true;
      } else object.traverse((part) => part.material.color.copy(colourOf(c === "grid" ? "line" : kinds[c].colour)));
    }
  };
  const drawLabels = (pen, width, height, sharp) => {
    pen.setTransform(sharp, 0, 0, sharp, 0, 0);
    const style = getComputedStyle(canvas);
    Object.assign(pen, { font: "12px system-ui, sans-serif", lineWidth: 4, lineJoin: "round", strokeStyle: style.backgroundColor, fillStyle: style.color });
    const write = (text, x, y) => (pen.strokeText(text, x, y), pen.fillText(text, x, y));
    const placed = [];
    for (const { t, p } of lines.filter((line) => line.t && isShown(line))) {
      const corners = Array.from({ length: p.length / 3 }, (_, i) => new THREE.Vector3(...p.slice(3 * i, 3 * i + 3)).project(camera));
      const wide = pen.measureText(t).width;
      const x = Math.min(width - wide - 4, Math.max(4, ((corners[0].x + 1) * width - wide) / 2));
      let y = Math.max(14, Math.min(...corners.map((each) => ((1 - each.y) * height) / 2)) - 5);
      while (placed.some((each) => Math.abs(each.y - y) < 14 && x < each.x + each.wide && each.x < x + wide)) y -= 14;
      placed.push({ x, y, wide });
      write(t, x, y);
    }
    write(`grid ${step < 0.1 ? `${+(1000 * step).toPrecision(3)} mm` : `${+step.toPrecision(3)} m`}; x red, y green, z blue`, 8, height - 10);
  };
  const draw = () => {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return; // in a closed part of the page
    const sharp = Math.min(2, window.devicePixelRatio || 1);
    [canvas.width, canvas.height] = [width * sharp, height * sharp];
    renderer.setPixelRatio(sharp);
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    for (const object of scene.children) object.visible = isShown(object.userData);
    renderer.render(scene, camera);
    const pen = canvas.getContext("2d");
    pen.drawImage(renderer.domElement, 0, 0);
    drawLabels(pen, width, height, sharp);
  };
  const corners = Array.from({ length: all.length / 3 }, (_, i) => new THREE.Vector3(...all.slice(3 * i, 3 * i + 3)));
  const lookFrom = (direction) => {
    controls.target.copy(centre);
    camera.position.set(...direction).setLength(4 * radius).add(centre);
    draw(); // sets the sides of the picture
    for (let i = 0; i < 4; i++) {
      controls.update();
      camera.updateMatrixWorld();
      const seen = corners.map((corner) => corner.clone().project(camera)).flatMap(({ x, y }) => [Math.abs(x), Math.abs(y)]);
      camera.position.sub(centre).multiplyScalar(Math.max(...seen) / 0.85).add(centre);
    }
    controls.update();
    draw();
  };
  for (const [name, direction] of Object.entries(VIEWS)) {
    const button = newElement("button", { type: "button", textContent: name });
    button.addEventListener("click", () => lookFrom(direction));
    tools.append(button);
  }
  if (collections.length > 1) {
    const slider = newElement("input", { type: "range", min: -1, max: collections.length - 1, value: -1 });
    const said = newElement("output", { textContent: "all collections" });
    slider.addEventListener("input", () => {
      chosen = +slider.value;
      said.textContent = chosen < 0 ? "all collections" : `collection ${collections[chosen]}`;
      draw();
    });
    tools.append(newElement("label", { textContent: "Collection " }), said);
    tools.querySelector("label").append(slider);
  }
  tools.append(newElement("span", { className: "soft", textContent: "Drag to turn it, Ctrl and wheel or + and - for its size." }));
  for (const entry of box.parentElement.querySelectorAll(".legend [data-kind]")) {
    const label = newElement("label", {});
    const ticked = newElement("input", { type: "checkbox", checked: true });
    ticked.addEventListener("change", () => {
      hidden[ticked.checked ? "delete" : "add"](entry.dataset.kind);
      draw();
    });
    label.append(ticked, ...entry.childNodes);
    entry.append(label);
  }
  controls.addEventListener("change", draw);
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in KEYS)) return;
    const [method, amount] = KEYS[event.key];
    controls[method](amount);
    event.preventDefault();
  });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => (takeColours(), draw()));
  new ResizeObserver(draw).observe(canvas);
  takeColours();
  lookFrom(VIEWS.Whole);
};

const inView = new IntersectionObserver((entries) => {
  for (const { target } of entries.filter((entry) => entry.isIntersecting)) {
    inView.unobserve(target);
    (renderer ??= unpackLibrary()).then?.((found) => (renderer = found));
    Promise.resolve(renderer).then((found) => found && openScene(target));
  }
}, { rootMargin: "300px" });
for (const box of document.querySelectorAll(".turning")) inView.observe(box);
