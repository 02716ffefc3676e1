"use strict";
(() => {
  const content = JSON.parse(document.getElementById("plot-data").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const narrow = matchMedia("(max-width: 40rem)");
  const jointChoice = document.getElementById("joint");
  const boxes = [...document.querySelectorAll("#controls .run")];
  const canvases = content.plots.map((plot) => document.getElementById("plot-" + plot.name));
  const config = {
    responsive: true, displaylogo: false, showSendToCloud: false, plotlyServerURL: "",
    // These and no others, whatever a new version of the library brings: some of its buttons send the data away.
    modeBarButtons: [["toImage"], ["zoom2d", "pan2d"], ["zoomIn2d", "zoomOut2d", "resetScale2d"]],
  };
  let span = null; // seconds shown, in all plots alike; null shows all
  let drawing = false;

  function ink(name) {
    return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  }

  function shownTraces(plot) {
    const joint = jointChoice ? Number(jointChoice.value) : content.first_joint;
    return plot.by_joint ? plot.traces[joint] : plot.traces;
  }

  function trace(drawn, plot, traces, previous) {
    const box = boxes[drawn.run];
    const hidden = previous && previous.find((other) => other.name === drawn.name);
    const visible = box && !box.checked ? false : hidden && hidden.visible === "legendonly" ? "legendonly" : true;
    return {
      type: "scatter", mode: "lines", name: drawn.name, x: drawn.x, y: drawn.y, visible,
      line: { color: ink(drawn.ink), width: drawn.width, dash: drawn.dash },
      hovertemplate: "%{y:.4~g} " + plot.unit, connectgaps: false,
    };
  }

  function layout(plot, count) {
    const axis = { gridcolor: ink("grid"), zerolinecolor: ink("grid"), linecolor: ink("soft"), tickcolor: ink("soft") };
    const marks = content.changes.map((change) => ({
      type: "rect", xref: "x", yref: "paper", x0: change.start, x1: change.end, y0: 0, y1: 1,
      line: { color: ink("change"), width: 1.2 }, fillcolor: ink("change"), opacity: change.end > change.start ? 0.25 : 1,
    }));
    const names = plot.labelled ? content.changes.map((change) => ({
      x: change.start, xref: "x", y: 1, yref: "paper", text: narrow.matches ? "change" : change.label, showarrow: false,
      xanchor: change.late ? "right" : "left", yanchor: "bottom", font: { size: 12, color: ink("change") },
    })) : [];
    const time = { ...axis, title: { text: "time [s]", standoff: 6 }, automargin: true };
    time.range = [...(span || content.span)]; // a copy: the library writes into it
    const value = { ...axis, title: narrow.matches ? undefined : { text: plot.axis, standoff: 4 }, automargin: false, type: plot.scale };
    if (plot.ticks) Object.assign(value, { tickmode: "array", tickvals: plot.ticks, ticktext: plot.ticks.map(String) });
    if (plot.range) value.range = plot.range;
    return {
      autosize: true, height: narrow.matches ? 250 + 20 * count : 300, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: "system-ui, sans-serif", size: 13, color: ink("ink") }, hovermode: "x unified",
      hoverlabel: { bgcolor: ink("box"), bordercolor: ink("line"), font: { color: ink("ink") }, namelength: -1 },
      margin: { l: narrow.matches ? 40 : 64, r: 10, t: plot.labelled ? 26 : 8, b: 8 }, dragmode: narrow.matches ? false : "zoom",
      showlegend: true, legend: { orientation: "h", x: 0, y: -0.22, yanchor: "top", itemdoubleclick: "toggleothers" },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: ink("soft"), activecolor: ink("ink"), orientation: "h" },
      shapes: marks, annotations: names, xaxis: time, yaxis: value, 
    };
  }

  async function draw() {
    drawing = true;
    await Promise.all(content.plots.map((plot, i) => {
      const traces = shownTraces(plot);
      const drawn = traces.map((one) => trace(one, plot, traces, canvases[i].data)).filter((one) => one.visible !== false);
      return Plotly.react(canvases[i], drawn, layout(plot, drawn.length), config);
    }));
    drawing = false;
  }

  function follow(canvas, change) {
    if (drawing) return;
    if (change["xaxis.autorange"]) span = null;
    else if ("xaxis.range[0]" in change) span = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
    else if ("xaxis.range" in change) span = change["xaxis.range"].slice();
    else return;
    drawing = true;
    const range = span || content.span;
    Promise.all(canvases.map((other) => Plotly.relayout(other, { "xaxis.range": range.slice() })))
      .finally(() => { drawing = false; });
  }

  function film() {
    const data = document.getElementById("film-data");
    if (!data) return;
    const bytes = Uint8Array.from(atob(data.textContent.trim()), (letter) => letter.charCodeAt(0));
    document.getElementById("video").src = URL.createObjectURL(new Blob([bytes], { type: "video/mp4" }));
    data.remove();
  }

  film();
  draw().then(() => {
    canvases.forEach((canvas) => canvas.on("plotly_relayout", (change) => follow(canvas, change)));
    document.documentElement.dataset.ready = "yes";
  });
  dark.addEventListener("change", draw);
  narrow.addEventListener("change", draw);
  boxes.forEach((box) => box.addEventListener("change", draw));
  if (jointChoice) {
    jointChoice.addEventListener("change", () => {
      const name = jointChoice.selectedOptions[0].textContent;
      document.querySelectorAll("h3 .joint").forEach((place) => { place.textContent = name; });
      draw();
    });
  }
  document.getElementById("whole").addEventListener("click", () => { span = null; draw(); });
  const close = document.getElementById("close");
  if (close) close.addEventListener("click", () => { span = [...content.close_up]; draw(); });
  document.getElementById("controls").addEventListener("submit", (event) => event.preventDefault());
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => { part.open = true; }));
})();
