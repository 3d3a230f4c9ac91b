// The page: camera, controls, the slider, labels.

const $ = (id) => document.getElementById(id);
const FIELD = (32 * Math.PI) / 180; // of view, vertically
const HOME = { azimuth: 0.62, elevation: 0.36 };

const page = {
  scene: null, // head and arrays of the contacts
  steps: [], // by growing count
  step: null, // the one shown
  renderer: null,
  camera: { ...HOME, distance: 3, target: [0, 0, 0] },
  up: "y",
  count: 1,
  box: null, // low and high corner of all that is shown, in the scene
  pending: false,
};

function number(value, digits = 4) {
  const size = Math.abs(value);
  if (size && (size < 1e-4 || size >= 1e7)) return value.toExponential(digits - 1);
  return value.toLocaleString("en", { maximumSignificantDigits: digits, useGrouping: false });
}

const percent = (share) => `${number(100 * share, 2)} %`;

// A place of the scene in the user's frame, with a thousandth of the object as the last digit.
function coordinates(p) {
  const { centre, side } = page.scene;
  const decimals = Math.min(Math.max(Math.ceil(-Math.log10(side)) + 3, 0), 12);
  return p.map((c, i) => (centre[i] + side * c).toFixed(decimals));
}

const toScene = (p) => p.map((c, i) => (c - page.scene.centre[i]) / page.scene.side);
const contact = (i) => [0, 1, 2].map((axis) => page.renderer.positions[3 * i + axis]);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const shownCount = () => Math.ceil(page.count / page.scene.every);

function redraw() {
  if (page.pending || !page.renderer) return;
  page.pending = true;
  requestAnimationFrame(() => {
    page.pending = false;
    draw();
  });
}

// Right, above and towards the viewer, in the scene's axes; and in the display's the eye.
function cameraFrame() {
  const { azimuth, elevation, distance, target } = page.camera;
  const towards = [
    Math.sin(azimuth) * Math.cos(elevation),
    Math.sin(elevation),
    Math.cos(azimuth) * Math.cos(elevation),
  ];
  const right = [Math.cos(azimuth), 0, -Math.sin(azimuth)];
  const back = (p) => turnedBack(page.up, p);
  const frame = { right: back(right), above: back(cross(towards, right)), towards: back(towards) };
  return { ...frame, eye: add(target, scaled(frame.towards, distance)) };
}

function currentView() {
  const { renderer, camera } = page;
  const { canvas } = renderer;
  const { right, above, towards, eye } = cameraFrame();
  const size = Math.hypot(...[0, 1, 2].map((i) => page.box[1][i] - page.box[0][i]));
  const far = camera.distance + 4 * size;
  const checked = (id) => $(id).checked;
  const upward = turnedBack(page.up, [0, 1, 0]);
  const shown = shownCount();
  const hex = (name) => [1, 3, 5].map((i) => parseInt(css(name).slice(i, i + 2), 16) / 255);
  return {
    view: viewMatrix(right, above, towards, eye),
    projection: perspective(FIELD, canvas.width / canvas.height, Math.max(camera.distance - 2 * size, 0.004 * camera.distance), far),
    above: [dot(right, upward), dot(above, upward), dot(towards, upward)],
    pixel: (2 * Math.tan(FIELD / 2)) / canvas.height,
    density: devicePixelRatio,
    radius: page.radius,
    least: 1.6 * devicePixelRatio,
    arrow: 0.17,
    accent: linear(css("--accent")),
    inner: hex("--inner"),
    outer: hex("--outer"),
    ink: hex("--floor"),
    step: page.gridStep / page.scene.side,
    floor: Math.min(Math.max((camera.elevation + 0.02) * 12, 0), 1),
    count: shown,
    lastShown: shown < page.scene.outlier.length,
    contactsShown: checked("contacts"),
    lines: checked("contacts") && checked("paths") ? page.linesBefore[shown] : 0,
    ticks: checked("contacts") && checked("normals") && page.scene.normal ? shown : 0,
    meshShown: checked("mesh"),
    closed: Boolean(page.step.closed),
    opacity: Number($("opacity").value),
    arrowsShown: checked("suggestions"),
  };
}

function draw() {
  const { renderer } = page;
  const { canvas, gl } = renderer;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((n) => Math.max(Math.round(n * devicePixelRatio), 1));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const view = currentView();
  renderer.draw(view);
  const error = gl.getError();
  if (error && !gl.isContextLost()) console.error(`WebGL error ${error}`);
  placeLabels(view);
  drawAxes();
}

// Pixels of the window where a place of the scene appears.
function onScreen(view, p) {
  const clip = transform(multiply(view.projection, view.view), [...p, 1]);
  const { clientWidth, clientHeight } = page.renderer.canvas;
  return [((clip[0] / clip[3] + 1) / 2) * clientWidth, ((1 - clip[1] / clip[3]) / 2) * clientHeight, clip[3]];
}

function placeLabels(view) {
  const labels = $("labels").children;
  page.arrows.forEach(({ tip, away }, k) => {
    const [x, y, depth] = onScreen(view, add(tip, scaled(away, 1.22 * view.arrow)));
    labels[k].hidden = !view.arrowsShown || depth <= 0;
    labels[k].style.left = `${x}px`;
    labels[k].style.top = `${y}px`;
  });
  clearTimeout(page.resting);
  page.resting = setTimeout(() => fadeLabels(view), 80);
}

// Once the camera rests: labels of arrows that something hides are faint.
function fadeLabels(view) {
  const labels = $("labels").children;
  page.arrows.forEach(({ tip, away }, k) => {
    if (labels[k].hidden) return;
    const seen = [0.2, 0.5, 0.9].some((part) => {
      const [x, y] = onScreen(view, add(tip, scaled(away, part * view.arrow)));
      return page.renderer.pick(view, Math.floor(x * devicePixelRatio), Math.floor(y * devicePixelRatio)) === ARROW_IDS + k;
    });
    labels[k].classList.toggle("behind", !seen);
  });
}

function drawAxes() {
  const { right, above, towards } = cameraFrame();
  const axes = [0, 1, 2].map((i) => ({ x: 34 * right[i], y: -34 * above[i], z: towards[i], i }));
  const parts = [];
  for (const { x, y, i } of axes.sort((a, b) => a.z - b.z)) {
    const colour = ["#e0393e", "#2f9e44", "#2b7de0"][i];
    parts.push(svg("line", { x1: 0, y1: 0, x2: x, y2: y, stroke: colour, "stroke-width": 3.5, "stroke-linecap": "round" }));
    const text = svg("text", { x: 1.3 * x, y: 1.3 * y + 5, fill: colour, "text-anchor": "middle" });
    text.textContent = "xyz"[i];
    parts.push(text);
  }
  $("axes").replaceChildren(...parts);
}

function svg(name, attributes) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

function colourContacts() {
  const { scene, renderer } = page;
  const shown = scene.outlier.length;
  const byStroke = document.querySelector("input[name=colour]:checked").value === "stroke";
  $("order-ramp").hidden = byStroke;
  const colours = new Float32Array(3 * shown);
  const known = scene.strokes.map((_, k) => strokeColour(k));
  for (let i = 0; i < shown; i++) {
    const colour = byStroke ? known[scene.stroke[i]] : onRamp(RAMPS.order, i / Math.max(shown - 1, 1));
    colours.set(scene.outlier[i] ? [0.35, 0.35, 0.35] : colour, 3 * i);
  }
  renderer.setContacts(renderer.positions, colours);

  // Contacts that follow each other in a stroke are joined.
  const [starts, ends, tints] = [[], [], []];
  page.linesBefore = new Uint32Array(shown + 1);
  for (let i = 0; i < shown; i++) {
    if (i && scene.stroke[i] === scene.stroke[i - 1] && !scene.outlier[i] && !scene.outlier[i - 1]) {
      starts.push(...contact(i - 1));
      ends.push(...contact(i));
      tints.push(...colours.subarray(3 * i, 3 * i + 3));
    }
    page.linesBefore[i + 1] = starts.length / 3;
  }
  const floats = (list) => new Float32Array(list);
  renderer.fill(renderer.lines, { a_start: floats(starts), a_end: floats(ends), a_colour: floats(tints) });
  if (scene.normal) {
    const tips = renderer.positions.map((c, k) => c + (0.04 / 127) * scene.normal[(k % 3) * shown + Math.floor(k / 3)]);
    renderer.fill(renderer.ticks, { a_start: renderer.positions, a_end: tips, a_colour: colours });
  }
}

function showStep(step) {
  page.step = step;
  const { renderer } = page;
  if (step.face && !step.corners) step.corners = corners(meshPositions(step), step.face, step.smooth);
  if (step.corners) {
    const count = step.face.length;
    const colour = new Float32Array(3 * count);
    const confident = step.confidence && $("confidence").checked;
    const table = Array.from({ length: 256 }, (_, k) => onRamp(RAMPS.confidence, k / 255));
    const plain = [0.38, 0.5, 0.63];
    for (let k = 0; k < count; k++) colour.set(confident ? table[step.confidence[step.face[k]]] : plain, 3 * k);
    renderer.setMesh({ ...step.corners, colour });
  } else {
    renderer.setMesh(null);
  }
  $("confidence-row").hidden = !step.confidence;
  $("tolerance").textContent = step.tolerance ? `that the surface is within ${number(step.tolerance, 2)}` : "";
  $("confidence-ramp").hidden = !step.confidence || !$("confidence").checked;
  placeFloor();
  listSuggestions(step.suggestions);
  showFacts();
  for (const mark of $("marks").children) mark.classList.toggle("used", Number(mark.dataset.count) === step.count);
  redraw();
}

function placeFloor() {
  const [low, high] = page.box.map((corner) => turned(page.up, corner));
  const [bottom, top] = [0, 1, 2].map((i) => [Math.min(low[i], high[i]), Math.max(low[i], high[i])])
    .reduce((box, [a, b]) => [[...box[0], a], [...box[1], b]], [[], []]);
  const middle = scaled(add(bottom, top), 0.5);
  const reach = 1.1 * Math.hypot(top[0] - bottom[0], top[1] - bottom[1], top[2] - bottom[2]);
  // The grid's lines lie at whole multiples of its step in the user's frame.
  const { side, centre } = page.scene;
  page.gridStep = niceStep((reach * side) / 14);
  const offset = turned(page.up, centre);
  const snap = (value, axis) => {
    const at = offset[axis] + value * side;
    return (Math.round(at / (5 * page.gridStep)) * 5 * page.gridStep - offset[axis]) / side;
  };
  page.renderer.setFloor(page.up, [snap(middle[0], 0), bottom[1] - 0.002, snap(middle[2], 2)], 1.6 * reach);
}

function listSuggestions(suggestions) {
  page.arrows = suggestions.map(({ position, direction }) => ({ tip: toScene(position), away: unit(scaled(direction, -1)) }));
  page.renderer.setArrows(page.arrows.map((a) => a.tip), page.arrows.map((a) => a.away));
  $("suggestions-set").hidden = !page.steps.some((step) => step.suggestions.length);
  $("labels").replaceChildren(...suggestions.map((_, k) => element("span", k + 1)));
  $("next").replaceChildren(
    ...suggestions.map((suggestion, k) => {
      const row = element("tr");
      const cell = element("td");
      cell.append(element("span", k + 1, "badge"));
      row.append(cell, ...coordinates(page.arrows[k].tip).map((c) => element("td", c)), element("td", percent(suggestion.gain)));
      row.title = "Look at it";
      row.onclick = () => face(page.arrows[k].away);
      return row;
    }),
  );
}

// Turns the camera to look against a direction of the scene.
function face(away) {
  const [x, y, z] = turned(page.up, away);
  const aim = { azimuth: Math.atan2(x, z), elevation: Math.min(Math.max(Math.asin(y), -1.2), 1.2) };
  const from = { ...page.camera };
  const turn = ((aim.azimuth - from.azimuth + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
  const began = performance.now();
  const frame = (now) => {
    const t = Math.min(Math.max((now - began) / 450, 0), 1);
    const eased = t * t * (3 - 2 * t);
    page.camera.azimuth = from.azimuth + eased * turn;
    page.camera.elevation = from.elevation + eased * (aim.elevation - from.elevation);
    draw();
    if (t < 1) requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
}

function showFacts() {
  const { scene, step } = page;
  const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
  const extent = page.extent.map((length) => number(length, 3)).join(" × ");
  const facts = [
    ["Contacts", `${scene.count}${scene.outliers ? ` (${plural(scene.outliers, "outlier")})` : ""}`],
    ["Strokes", `${scene.strokes.length}${scene.guessed ? " (from jumps)" : ""}`],
    ["Extent", extent],
    ["Grid", number(page.gridStep, 3)],
  ];
  if (scene.mesh) facts.push(["Mesh", scene.mesh]);
  else if (step.face) facts.push(["Mesh from", plural(step.count, "contact")]);
  if (step.face) facts.push(["Faces", `${step.faces}${step.closed ? ", closed" : ", open"}`]);
  if (step.volume !== null && step.volume !== undefined) facts.push(["Volume", number(step.volume)]);
  $("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
  const thinned = scene.every > 1 ? [`1 of every ${scene.every} contacts is shown`] : [];
  $("notes").textContent = [...thinned, ...step.notes].join("; ");
}

// The last step made from no more contacts than the slider says (the first one if there is none).
const stepFor = (count) => page.steps.findLast((step) => step.count <= count) || page.steps[0];

function setCount(count) {
  const { scene } = page;
  page.count = Math.min(Math.max(Math.round(count), 1), scene.count);
  $("count").value = page.count;
  const stroke = scene.stroke[shownCount() - 1];
  $("counted").replaceChildren(
    element("b", page.count),
    ` of ${scene.count} contacts`,
    element("small", `stroke ${stroke + 1} of ${scene.strokes.length}`),
  );
  const step = stepFor(page.count);
  if (step !== page.step) showStep(step);
  redraw();
}

function markSteps() {
  const span = Math.max(page.scene.count - 1, 1);
  $("marks").replaceChildren(
    ...(page.scene.mesh ? [] : page.steps).map((step) => {
      const mark = element("i");
      mark.dataset.count = step.count;
      mark.style.left = `${(100 * (step.count - 1)) / span}%`;
      mark.classList.toggle("used", step === page.step);
      return mark;
    }),
  );
}

// A live page asks its server for the mesh from exactly so many contacts.
async function askForStep(count, signal) {
  const answer = await fetch(`step?count=${count}`, { signal });
  if (!answer.ok) throw new Error(await answer.text());
  const step = await unpack(await answer.arrayBuffer());
  if (page.steps.some((known) => known.count === count)) return;
  page.steps = [...page.steps, step].sort((a, b) => a.count - b.count);
  markSteps();
  setCount(page.count);
}

// The slider has come to rest.
async function settle() {
  const { count } = page;
  page.wanted?.abort();
  if (!page.scene.live || page.steps.some((step) => step.count === count)) return;
  const { signal } = (page.wanted = new AbortController());
  $("notes").textContent = `reconstructing from ${count} contacts …`;
  try {
    await askForStep(count, signal);
  } catch (error) {
    if (!signal.aborted) $("notes").textContent = `no mesh from ${count} contacts: ${error.message}`;
  }
}

async function askAhead() {
  for (const count of page.scene.ahead) {
    try {
      await askForStep(count);
    } catch {
      return; // the server has ended; the slider says so once it is moved
    }
  }
}

function play() {
  if (page.playing) {
    cancelAnimationFrame(page.playing);
    stop();
    return;
  }
  const { scene } = page;
  let at = page.count >= scene.count ? 1 : page.count;
  const perSecond = scene.count / 14;
  let before = null;
  const frame = (now) => {
    at += before === null ? 0 : (perSecond * Math.min(now - before, 200)) / 1000;
    before = now;
    setCount(at);
    if (at < scene.count) page.playing = requestAnimationFrame(frame);
    else stop();
  };
  $("play").textContent = "❚❚";
  page.playing = requestAnimationFrame(frame);
}

function stop() {
  page.playing = null;
  $("play").textContent = "▶";
  settle();
}

function reset() {
  const { box } = page;
  const { clientWidth, clientHeight } = page.renderer.canvas;
  const radius = 0.5 * Math.hypot(...[0, 1, 2].map((i) => box[1][i] - box[0][i]));
  // The panel covers the left of a wide window, the bar the bottom.
  const wide = clientWidth > 640;
  const free = [(clientWidth - (wide ? 310 : 0)) / clientHeight, (clientHeight - 90) / clientHeight];
  const distance = (1.06 * radius) / Math.sin(FIELD / 2) / Math.min(free[0], free[1], 1);
  const target = scaled(add(box[0], box[1]), 0.5);
  page.camera = { ...HOME, distance, target };
  const { right, above } = cameraFrame();
  const perPixel = (2 * distance * Math.tan(FIELD / 2)) / clientHeight;
  page.camera.target = add(add(target, scaled(right, wide ? -149 * perPixel : 0)), scaled(above, -37 * perPixel));
  redraw();
}

function listenToCanvas(canvas) {
  const pointers = new Map();
  const move = (dx, dy) => {
    const { right, above } = cameraFrame();
    const perPixel = (2 * page.camera.distance * Math.tan(FIELD / 2)) / canvas.clientHeight;
    page.camera.target = add(page.camera.target, add(scaled(right, -dx * perPixel), scaled(above, dy * perPixel)));
  };
  const turn = (dx, dy) => {
    page.camera.azimuth -= 0.008 * dx;
    page.camera.elevation = Math.min(Math.max(page.camera.elevation + 0.008 * dy, -1.55), 1.55);
  };
  const zoom = (factor) => {
    page.camera.distance = Math.min(Math.max(page.camera.distance * factor, 0.02), 40);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    $("tip").hidden = true;
  });
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) {
      hover(event);
      return;
    }
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (pointers.size === 1) {
      if (event.buttons & 6 || event.shiftKey || event.ctrlKey) move(dx, dy);
      else turn(dx, dy);
    } else {
      const [a, b] = [...pointers.values()];
      const other = a.pointerId === event.pointerId ? b : a;
      const apart = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY) || 1;
      zoom(apart(before) / apart(event));
      move(dx / 2, dy / 2);
    }
    pointers.set(event.pointerId, event);
    redraw();
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerleave", () => ($("tip").hidden = true));
  canvas.addEventListener("dblclick", reset);
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      zoom(Math.exp(event.deltaY * (event.deltaMode ? 0.05 : 0.0012)));
      redraw();
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (steps) (event.shiftKey ? move : turn)(12 * -steps[0], 12 * -steps[1]);
    else if (event.key === "+" || event.key === "=") zoom(0.9);
    else if (event.key === "-") zoom(1 / 0.9);
    else if (event.key === " ") play();
    else return;
    event.preventDefault();
    redraw();
  });
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => show());
}

// Says what lies under the mouse.
function hover(event) {
  clearTimeout(page.hovering);
  page.hovering = setTimeout(() => {
    const id = page.renderer.pick(currentView(), Math.floor(event.offsetX * devicePixelRatio), Math.floor(event.offsetY * devicePixelRatio));
    const tip = $("tip");
    tip.hidden = id === 0;
    if (id === 0) return;
    if (id >= ARROW_IDS) {
      const k = id - ARROW_IDS;
      const { direction, gain, expected_error: off, clearance } = page.step.suggestions[k];
      const lines = [
        `${k + 1}: touch here to remove ${percent(gain)} of the expected error`,
        coordinates(page.arrows[k].tip).join("  "),
        `along ${direction.map((c) => c.toFixed(3)).join("  ")}`,
        `the surface may be ${number(off, 2)} off`,
        `the path is free for ${number(clearance, 2)}`,
      ];
      tip.textContent = lines.join("\n");
    } else {
      const i = id - 1;
      const stroke = page.scene.stroke[i];
      const outlier = page.scene.outlier[i] ? " (outlier)" : "";
      tip.textContent = `contact ${i * page.scene.every + 1}, stroke ${page.scene.strokes[stroke]}${outlier}\n${coordinates(contact(i)).join("  ")}`;
    }
    tip.style.left = `${Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8)}px`;
    tip.style.top = `${Math.max(event.clientY - tip.offsetHeight - 10, 8)}px`;
  }, 40);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  $("theme").textContent = name === "dark" ? "Light" : "Dark";
  redraw();
}

function fold(folded) {
  $("panel").classList.toggle("folded", folded);
  $("fold").setAttribute("aria-expanded", !folded);
}

function csv() {
  const rows = page.step.suggestions.map((suggestion) => {
    const { position, direction, gain, expected_error: off, clearance } = suggestion;
    return [...position, ...direction, gain, off, clearance].map((c) => Number(c.toPrecision(10))).join(",");
  });
  return ["x,y,z,dx,dy,dz,gain,expected_error,clearance", ...rows, ""].join("\n"); // named as by `touchnet explore`
}

function listen() {
  for (const id of ["contacts", "paths", "normals", "mesh", "suggestions", "opacity"]) $(id).oninput = redraw;
  for (const radio of document.querySelectorAll("input[name=colour]")) {
    radio.oninput = () => {
      colourContacts();
      redraw();
    };
  }
  for (const radio of document.querySelectorAll("input[name=up]")) {
    radio.oninput = () => {
      page.up = radio.value;
      placeFloor();
      showFacts();
      reset();
    };
  }
  $("confidence").oninput = () => showStep(page.step);
  $("count").oninput = (event) => setCount(Number(event.target.value));
  $("count").onchange = settle;
  $("play").onclick = play;
  $("reset").onclick = reset;
  $("fold").onclick = () => fold(!$("panel").classList.contains("folded"));
  $("theme").onclick = () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
  $("picture").onclick = () => {
    draw(); // what was drawn may be gone once the frame has been shown
    $("picture").href = page.renderer.canvas.toDataURL("image/png");
  };
  $("copy").onclick = async () => {
    await navigator.clipboard.writeText(csv());
    $("copy").textContent = "Copied";
    setTimeout(() => ($("copy").textContent = "Copy as CSV"), 1500);
  };
  addEventListener("resize", redraw);
}

// Everything that has to be sent to the graphics card, at the start and after it forgot.
function show() {
  page.renderer = new Renderer($("view"));
  const { scene } = page;
  const shown = scene.outlier.length;
  const positions = new Float32Array(3 * shown);
  for (let i = 0; i < 3 * shown; i++) positions[i] = scene.position[(i % 3) * shown + Math.floor(i / 3)];
  page.renderer.positions = positions;
  page.box = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  const widen = (axis, value) => {
    page.box[0][axis] = Math.min(page.box[0][axis], value);
    page.box[1][axis] = Math.max(page.box[1][axis], value);
  };
  for (let i = 0; i < 3 * shown; i++) if (!scene.outlier[Math.floor(i / 3)]) widen(i % 3, positions[i]);
  const last = page.steps[page.steps.length - 1];
  if (last.face) {
    for (let axis = 0; axis < 3; axis++) {
      widen(axis, last.low[axis]);
      widen(axis, last.low[axis] + last.size[axis]);
    }
  }
  page.extent = [0, 1, 2].map((i) => scene.side * (page.box[1][i] - page.box[0][i]));
  if (!page.extent.some(Boolean)) page.box = page.box.map((corner, k) => corner.map((c) => c + k - 0.5)); // a single place
  // Dense contacts are drawn smaller.
  page.radius = Math.min(Math.max(0.24 / Math.sqrt(shown), 0.0012), 0.011);
  page.arrows = [];
  colourContacts();
  page.step = null;
  setCount(page.count);
}

async function start() {
  for (const [name, stops] of Object.entries(RAMPS)) {
    document.querySelector(`#${name}-ramp i`).style.background = `linear-gradient(to right, ${stops.join(", ")})`;
  }
  fold(innerWidth <= 640);
  setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  [page.scene, ...page.steps] = await Promise.all([...document.querySelectorAll("script.data")].map(unpackInlined));
  const { scene } = page;
  $("title").textContent = document.title = scene.title;
  $("count").max = scene.count;
  $("normals-row").hidden = !scene.normal;
  $("mesh-set").hidden = !scene.live && !page.steps.some((step) => step.face);
  page.up = scene.up;
  document.querySelector(`input[name=up][value=${scene.up}]`).checked = true;
  page.count = scene.count;
  show();
  markSteps();
  reset();
  listen();
  listenToCanvas($("view"));
  draw();
  document.documentElement.dataset.state = "ready";
  askAhead();
}

start().catch((error) => {
  console.error(error.message);
  $("failure").textContent = `This page cannot be shown: ${error.message}`;
  $("failure").hidden = false;
});
