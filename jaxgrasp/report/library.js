// What every page needs: the plotting library unpacked, data read, and what went wrong said.
"use strict";
// Dragging zooms and a double click undoes it; what is left is saving a picture and going home.
const BUTTONS = ["lasso2d", "select2d", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "autoScale2d", "zoom3d", "pan3d",
  "orbitRotation", "tableRotation", "resetCameraLastSave3d"];
// By itself plotly offers to send a figure's data to its makers' cloud: a report keeps its data to itself.
const PRIVATE = { showSendToCloud: false, plotlyServerURL: "", displaylogo: false };
const config = { ...PRIVATE, responsive: true, modeBarButtonsToRemove: BUTTONS };
const stored = (id) => JSON.parse(document.getElementById(id).textContent);

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
