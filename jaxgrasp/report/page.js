// Unpacks the plotting library, draws the figures, and shows one three-dimensional case at a time.
"use strict";
(async function () {
  // Dragging zooms and a double click undoes it; what is left is saving a picture and going home.
  const BUTTONS = ["lasso2d", "select2d", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "autoScale2d", "zoom3d", "pan3d",
    "orbitRotation", "tableRotation", "resetCameraLastSave3d"];
  // By itself plotly offers to send a figure's data to its makers' cloud: a report keeps its data to itself.
  const PRIVATE = { showSendToCloud: false, plotlyServerURL: "", displaylogo: false };
  const config = { ...PRIVATE, responsive: true, modeBarButtonsToRemove: BUTTONS };
  const stored = (id) => JSON.parse(document.getElementById(id).textContent);
  const figures = document.querySelectorAll("[data-figure]");

  async function loadLibrary() {
    const packed = atob(document.getElementById("library").textContent);
    const bytes = Uint8Array.from(packed, (c) => c.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
    if (!window.Plotly) throw new Error("the plotting library did not start");
  }

  function say(element, text) {
    const note = document.createElement("p");
    note.className = "empty";
    note.textContent = text;
    element.replaceChildren(note);
  }

  function setUpCases() {
    const element = document.getElementById("scene");
    if (!element) return;
    const scenes = stored("scenes");
    const chooser = document.getElementById("case");
    const picks = document.querySelectorAll(".pick");
    function show(index) {
      const at = (index + scenes.length) % scenes.length;
      chooser.value = String(at);
      for (const panel of document.querySelectorAll(".panel")) panel.hidden = Number(panel.dataset.case) !== at;
      for (const pick of picks) pick.closest("tr").classList.toggle("chosen", Number(pick.dataset.case) === at);
      // One element, drawn anew: a browser keeps few WebGL contexts, and this page needs only one.
      if (window.Plotly) Plotly.react(element, scenes[at].data, scenes[at].layout, config);
    }
    chooser.addEventListener("change", () => show(Number(chooser.value)));
    document.getElementById("before").addEventListener("click", () => show(Number(chooser.value) - 1));
    document.getElementById("after").addEventListener("click", () => show(Number(chooser.value) + 1));
    for (const pick of picks) pick.addEventListener("click", () => show(Number(pick.dataset.case)));
    show(0);
  }

  try {
    await loadLibrary();
    for (const element of figures) {
      const figure = stored(element.dataset.figure);
      Plotly.newPlot(element, figure.data, figure.layout, config);
    }
  } catch (error) {
    const reason = "The figures could not be drawn (" + error.message + "): they need a browser from 2023 or later.";
    for (const element of [...figures, document.getElementById("scene")]) if (element) say(element, reason);
  }
  setUpCases();
})();
