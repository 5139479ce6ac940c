"use strict";
// Numbers as text, charts, the bars of the achievements.

const $ = (id) => document.getElementById(id);
const jsonOf = (id) => JSON.parse($(id).textContent);
const references = jsonOf("references");

const whole = new Intl.NumberFormat("en-US", { maximumFractionDigits: 0 });
const compact = new Intl.NumberFormat("en-US", { notation: "compact", maximumFractionDigits: 1 });
const decimals = (value, digits) => Number(value).toFixed(digits);
const percent = (value) => (value > 0 && value < 0.1 ? "< 0.1" : decimals(value, 1)) + " %";
const words = (name) => name.replaceAll("_", " ");

// 3661 -> "1 h 1 min".
function span(seconds) {
  if (!Number.isFinite(seconds) || seconds < 0) return "–";
  if (seconds < 60) return `${Math.round(seconds)} s`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 60) return `${minutes} min`;
  const hours = Math.floor(minutes / 60);
  return hours < 48 ? `${hours} h ${minutes % 60} min` : `${Math.floor(hours / 24)} d ${hours % 24} h`;
}

// Changes the text only if it differs, so that nothing is drawn or announced for nothing.
function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

// An element with the class and the texts or elements as children.
function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

// The value of a custom property, which follows the light or dark theme.
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Charts of values over environment steps. `series`: {label, points: [{x, y}], colour: property, dashed}.
const charts = [];

function lineChart(canvas, { legend = false, beginAtZero = true } = {}) {
  const chart = new Chart(canvas, {
    type: "line",
    data: { datasets: [] },
    options: {
      animation: false,
      responsive: true,
      maintainAspectRatio: false,
      parsing: false,
      normalized: true,
      interaction: { mode: "nearest", axis: "x", intersect: false },
      scales: {
        x: { type: "linear", min: 0, ticks: { callback: (value) => compact.format(value), maxRotation: 0, autoSkipPadding: 24, includeBounds: false } },
        y: { beginAtZero, ticks: { callback: (value) => compact.format(value), maxTicksLimit: 6 } },
      },
      plugins: {
        legend: { display: legend, position: "bottom", labels: { boxWidth: 18, boxHeight: 2, padding: 14, filter: (item, { datasets }) => datasets.length <= 4 || item.lineDash.length > 0 } },
        tooltip: {
          callbacks: {
            title: (items) => `${whole.format(items[0].parsed.x)} steps`,
            label: (item) => ` ${item.dataset.label}: ${item.parsed.y < 100 ? decimals(item.parsed.y, 2) : whole.format(item.parsed.y)}`,
          },
        },
      },
    },
  });
  const entry = { chart, series: [] };
  charts.push(entry);
  paint(entry);
  return entry;
}

function show(entry, series, end) {
  entry.series = series;
  entry.chart.options.scales.x.max = end || undefined;
  paint(entry);
}

function paint({ chart, series }) {
  chart.data.datasets = series.map((line) => ({
    label: line.label,
    data: line.points,
    borderColor: colour(line.colour),
    backgroundColor: colour(line.colour),
    borderWidth: line.dashed ? 1.5 : 2,
    borderDash: line.dashed ? [5, 5] : [],
    pointRadius: line.points.length === 1 ? 3 : 0,
    pointHitRadius: 8,
    tension: 0,
  }));
  for (const axis of Object.values(chart.options.scales)) {
    axis.ticks.color = colour("--quiet");
    axis.grid = { color: colour("--line"), drawBorder: false };
  }
  chart.options.plugins.legend.labels.color = colour("--text");
  chart.update();
}

Chart.defaults.font.family = getComputedStyle(document.body).fontFamily;
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(paint));

// {steps, <name>} as points.
const pointsOf = (curve, name) => curve.steps.map((x, i) => ({ x, y: curve[name][i] }));
// A horizontal line at a published score.
const levels = (end) => references.scores.map(({ label, score, colour: of }) => (
  { label, points: [{ x: 0, y: score }, { x: end, y: score }], colour: of, dashed: true }));

// The rows of the achievements; update(rates) shows rates in percent by name.
function achievementBars(list) {
  const rows = {};
  for (const name of Object.keys(references.rates)) {
    const { ppo, random } = references.rates[name];
    const bar = make("b");
    const marks = [["random", random], ["ppo", ppo]].map(([kind, rate]) => {
      const mark = make("i", kind);
      mark.style.left = `calc(${rate}% - ${(rate * 4) / 100}px)`;
      return mark;
    });
    const track = make("div", "track", make("span", "", bar), ...marks);
    const rate = make("span", "rate", "–");
    const row = make("div", "achievement", make("span", "", words(name)), track, rate);
    row.setAttribute("role", "listitem");
    row.title = `PPO ${percent(ppo)}, random play ${percent(random)}`;
    track.setAttribute("role", "img");
    list.append(row);
    rows[name] = { bar, rate, track, ppo, random };
  }
  list.setAttribute("role", "list");
  return (rates) => {
    for (const [name, { bar, rate, track, ppo, random }] of Object.entries(rows)) {
      const value = rates[name] ?? 0;
      bar.style.transform = `translateX(${value - 100}%)`;
      setText(rate, percent(value));
      track.setAttribute("aria-label", `${percent(value)}; PPO ${percent(ppo)}, random play ${percent(random)}`);
    }
  };
}
