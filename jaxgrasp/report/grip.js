// Moves hand, object and arrows through the instants of a grip, and the cursor through its plots.
"use strict";
(async function () {
  const film = stored("film");
  const frames = film.frames;
  const [view, slider, play, close] = ["view", "instant", "play", "close"].map((id) => document.getElementById(id));
  const plots = document.querySelector("[data-figure]");
  const traces = Object.fromEntries(film.figure.data.map((trace, n) => [trace.name, n]));
  const moving = film.figure.data.map((_, n) => n).filter((n) => n !== traces.table);

  // A part whose pose is not known shrinks to a point, which has no area and is not seen.
  function posed(parts, poses) {
    const [x, y, z] = [[], [], []];
    for (const { body, corners } of parts) {
      const known = !poses[body].includes(null);
      const [a, b, c, u, d, e, f, v, g, h, i, w] = known ? poses[body] : Array(12).fill(0);
      for (const [p, q, r] of corners) {
        const gap = p === null;
        x.push(gap ? null : a * p + b * q + c * r + u);
        y.push(gap ? null : d * p + e * q + f * r + v);
        z.push(gap ? null : g * p + h * q + i * r + w);
      }
    }
    return { x, y, z };
  }

  function cross(a, b) {
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  }

  function across(along) {
    const sizes = along.map(Math.abs);
    const least = sizes.indexOf(Math.min(...sizes));
    const first = cross(along, [0, 1, 2].map((n) => (n === least ? 1 : 0)));
    const size = Math.hypot(...first);
    const unit = first.map((c) => c / size);
    return [unit, cross(along, unit)];
  }

  // Copies of the arrow's template, from each tail along each vector.
  function arrows(pairs) {
    const found = { x: [], y: [], z: [], i: [], j: [], k: [] };
    for (const [tail, vector] of pairs) {
      const length = Math.hypot(...vector);
      if (!(length > 0)) continue;
      const along = vector.map((c) => c / length);
      const [first, second] = across(along);
      const head = Math.min(film.arrow.head, length / 2);
      const start = found.x.length;
      for (const [u, v, s, h] of film.arrow.corners) {
        const at = (n) => tail[n] + head * (u * first[n] + v * second[n]) + (s * length + h * head) * along[n];
        found.x.push(at(0));
        found.y.push(at(1));
        found.z.push(at(2));
      }
      for (const [i, j, k] of film.arrow.faces) {
        found.i.push(start + i);
        found.j.push(start + j);
        found.k.push(start + k);
      }
    }
    return { ...found, visible: found.x.length > 0 };
  }

  function contactTexts({ links, touches, vectors, margins }) {
    return links.map((link, n) => {
      const size = Math.hypot(...vectors[n].slice(6));
      const margin = margins[n] === null ? "no load" : "friction margin " + margins[n].toFixed(1) + "°";
      return film.links[link] + " " + film.touches[touches[n]] + "<br>" + size.toPrecision(3) + " N, " + margin;
    });
  }

  // What every moving trace becomes at an instant, by the trace's number.
  function drawnAt(frame) {
    const own = {};
    for (const { trace, parts } of film.rigid) own[trace] = posed(parts, frame.poses);
    const { touches, vectors } = frame.contacts;
    const points = vectors.map((row) => row.slice(0, 3));
    const part = (row, from, size) => row.slice(from, from + 3).map((c) => size * c);
    own[traces.normals] = arrows(vectors.map((row, n) => [points[n], part(row, 3, film.normal)]));
    for (const [code, name] of Object.entries(film.touches)) {
      const those = vectors.map((row, n) => [points[n], part(row, 6, film.scale)]);
      own[traces[name]] = arrows(those.filter((_, n) => touches[n] === Number(code)));
    }
    const [x, y, z] = [0, 1, 2].map((n) => points.map((point) => point[n]));
    own[traces.contacts] = { x, y, z, hovertext: contactTexts(frame.contacts), visible: points.length > 0 };
    return own;
  }

  function restyled(own) {
    const names = ["x", "y", "z", "i", "j", "k", "visible", "hovertext"];
    // Plotly leaves alone what is undefined.
    return Object.fromEntries(names.map((name) => [name, moving.map((n) => own[n][name])]));
  }

  // The whole way of the hand, or a cube about it that goes with it: on equal axes either way.
  function window3d({ middle }) {
    const whole = film.figure.layout.scene;
    const range = (n) => [middle[n] - film.reach, middle[n] + film.reach];
    const ranges = ["xaxis", "yaxis", "zaxis"].map((name, n) => [name, close.checked ? range(n) : whole[name].range]);
    const update = Object.fromEntries(ranges.map(([name, range]) => ["scene." + name + ".range", range]));
    return { ...update, "scene.aspectratio": close.checked ? { x: 1, y: 1, z: 1 } : whole.aspectratio };
  }

  function tell(frame) {
    document.getElementById("clock").textContent = frame.time.toFixed(2) + " s";
    const state = document.getElementById("state");
    state.textContent = frame.said;
    state.style.color = film.colours[frame.hold];
  }

  // Drawing goes back to the last camera that plotly was told of: a view that is just being turned has moved on.
  function keepCamera() {
    const camera = view._fullLayout.scene?._scene?.getCamera?.();
    if (camera) view.layout.scene.camera = camera;
  }

  let shown = 0, busy = false, wanted = null, playing = false, started = 0;

  // One drawing at a time; of all that were asked for meanwhile only the last is drawn.
  async function show(at) {
    shown = at;
    slider.value = String(at);
    tell(frames[at]);
    wanted = at;
    if (busy || !window.Plotly) return;
    busy = true;
    try {
      while (wanted !== null) {
        const frame = frames[wanted];
        wanted = null;
        keepCamera();
        await Plotly.update(view, restyled(drawnAt(frame)), window3d(frame), moving);
        await Plotly.relayout(plots, { "shapes[0].x0": frame.time, "shapes[0].x1": frame.time });
      }
    } finally {
      busy = false;
    }
  }

  function nearest(time) {
    let best = 0;
    frames.forEach((frame, n) => {
      if (Math.abs(frame.time - time) < Math.abs(frames[best].time - time)) best = n;
    });
    return best;
  }

  function step(now) {
    if (!playing) return;
    const at = nearest(frames[0].time + (now - started) / 1000);
    if (at !== shown && !busy) show(at);
    if (shown === frames.length - 1) setPlaying(false);
    else requestAnimationFrame(step);
  }

  function setPlaying(on) {
    playing = on;
    play.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (shown === frames.length - 1) show(0);
    started = performance.now() - 1000 * (frames[shown].time - frames[0].time);
    requestAnimationFrame(step);
  }

  function pauseAt(at) {
    setPlaying(false);
    show(at);
  }

  tell(frames[0]);
  play.addEventListener("click", () => setPlaying(!playing));
  slider.addEventListener("input", () => pauseAt(Number(slider.value)));
  close.addEventListener("change", () => show(shown));
  document.addEventListener("keydown", (event) => {
    if (event.code !== "Space" || event.target === play || event.target === close) return;
    event.preventDefault();
    setPlaying(!playing);
  });
  try {
    await loadLibrary();
    const first = drawnAt(frames[0]);
    const data = film.figure.data.map((trace, n) => ({ ...trace, ...first[n] }));
    await Plotly.newPlot(view, data, structuredClone(film.figure.layout), config);
    const figure = stored(plots.dataset.figure);
    await Plotly.newPlot(plots, figure.data, figure.layout, config);
    plots.on("plotly_click", (event) => pauseAt(nearest(event.points[0].x)));
  } catch (error) {
    const reason = "The figures could not be drawn (" + error.message + "): they need a browser from 2023 or later.";
    for (const element of [view, plots]) say(element, reason);
  }
})();
