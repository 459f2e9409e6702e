"use strict";
const leaves = JSON.parse(document.getElementById("leaves").textContent);
const slider = document.getElementById("frame");
const plan = document.querySelector(".plan");
const number = (x, digits) => (x === null || x === undefined ? "-" : Number(x).toFixed(digits));
const percent = (x) => `${(100 * x).toFixed(1)} %`;

function rows(leaf) {
  const known = [
    ["frame", `${slider.value} of ${leaves.length}, ${leaf.time} s`],
    ["state", leaf.state],
    ["reason", leaf.reason],
    ["x y z", leaf.position.map((x) => `${number(x, 3)} m`).join("  ")],
    ["roll pitch yaw", leaf.attitude_deg.map((x) => `${number(x, 2)}°`).join("  ")],
    ["sigma x y z", leaf.sigmas.slice(0, 3).map((x) => `${number(1e3 * x, 1)} mm`).join("  ")],
    ["sigma about x y z", leaf.sigmas.slice(3).map((x) => `${number(x, 3)}°`).join("  ")],
    ["weak directions", leaf.weak.join(", ") || "none"],
    ["explained", percent(leaf.explained)],
    ["surfaces off by", `${number(leaf.model_sigma, 3)} m`],
  ];
  if (leaf.off) known.push(["error", `${number(1e3 * leaf.off[0], 1)} mm  ${number(leaf.off[1], 3)}°`]);
  if (leaf.nees !== null) known.push(["NEES per degree of freedom", number(leaf.nees, 2)]);
  for (const [name, count] of leaf.features) known.push([`features ${name.replace("_", " ")}`, `${count}`]);
  return known.concat(leaf.verdicts.map(([name, share]) => [name.replace("_", " "), percent(share)]));
}

function show(at) {
  if (leaves.length === 0) return;
  const k = Math.max(0, Math.min(leaves.length - 1, at));
  const leaf = leaves[k];
  slider.value = k;
  document.getElementById("picture").src = leaf.picture;
  const told = document.getElementById("told");
  told.replaceChildren();
  for (const [name, value] of rows(leaf)) {
    told.append(Object.assign(document.createElement("dt"), { textContent: name }));
    told.append(Object.assign(document.createElement("dd"), { textContent: value }));
  }
  const x = (1000 * (k + 0.5)) / leaves.length;
  for (const line of document.querySelectorAll(".now")) {
    line.setAttribute("x1", x);
    line.setAttribute("x2", x);
  }
  const { left, top, extent } = plan.dataset;
  const here = plan.querySelector(".here");
  here.setAttribute("cx", 20 + (380 * (leaf.position[0] - left)) / extent);
  here.setAttribute("cy", 20 + (380 * (top - leaf.position[1])) / extent);
}

let playing = 0;
function play() {
  if (playing) clearInterval(playing);
  playing = playing ? 0 : setInterval(() => show((Number(slider.value) + 1) % leaves.length), 200);
  document.getElementById("play").textContent = playing ? "stop" : "play";
}

slider.addEventListener("input", () => show(Number(slider.value)));
document.getElementById("before").addEventListener("click", () => show(Number(slider.value) - 1));
document.getElementById("after").addEventListener("click", () => show(Number(slider.value) + 1));
document.getElementById("play").addEventListener("click", play);
document.addEventListener("keydown", (e) => {
  if (e.target === slider) return;
  if (e.key === "ArrowLeft") show(Number(slider.value) - 1);
  if (e.key === "ArrowRight") show(Number(slider.value) + 1);
});
for (const strip of document.querySelectorAll(".strip")) {
  strip.addEventListener("click", (e) => {
    const box = strip.getBoundingClientRect();
    show(Math.floor(((e.clientX - box.left) / box.width) * leaves.length));
  });
}
show(0);
