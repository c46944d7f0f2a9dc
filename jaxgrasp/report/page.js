// Draws the figures, and shows one three-dimensional case at a time.
"use strict";
(async function () {
  const figures = document.querySelectorAll("[data-figure]");

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
      for (const pick of picks) pick.classList.toggle("chosen", Number(pick.dataset.case) === at);
      // One element, drawn anew: a browser keeps few WebGL contexts, and this page needs only one.
      if (window.Plotly) Plotly.react(element, scenes[at].data, scenes[at].layout, config);
    }
    chooser.addEventListener("change", () => show(Number(chooser.value)));
    document.getElementById("before").addEventListener("click", () => show(Number(chooser.value) - 1));
    document.getElementById("after").addEventListener("click", () => show(Number(chooser.value) + 1));
    for (const pick of picks) pick.addEventListener("click", () => {
      show(Number(pick.dataset.case));
      document.getElementById("cases").scrollIntoView({ behavior: "smooth" });
    });
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
