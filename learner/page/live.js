"use strict";
// The live page: polls the learner that it came from.

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

function lineChart(canvas, { legend = false } = {}) {
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
        y: { beginAtZero: true, ticks: { callback: (value) => compact.format(value), maxTicksLimit: 6 } },
      },
      plugins: {
        legend: { display: legend, position: "bottom", labels: { boxWidth: 18, boxHeight: 2, padding: 14 } },
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
  entry.chart.options.scales.x.max = end;
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

const kPollMs = 2000;
const activityColours = {
  update: "--s1", inference: "--s2", environment: "--s3", wire: "--s4", permits: "--s5", intake: "--s6", other: "--s7", idle: "--s8",
};
const stateWords = { TRAINING: "Training", PAUSED: "Paused", EVALUATING: "Evaluating", COMPLETE: "Complete" };

const live = { token: "", learner: "", tag: "", frame: 0, goal: 0, steer: false, state: "", stopping: false };

// Requests `path` with the token. It is relative to the page, before whose path a proxy may put its own. Throws {code, text} unless the
// server answers 200 or 304.
async function ask(path, options = {}) {
  const headers = { ...options.headers };
  if (live.token) headers.Authorization = `Bearer ${live.token}`;
  const reply = await fetch(path, { ...options, headers, cache: "no-store", credentials: "omit", signal: AbortSignal.timeout(8000) });
  if (!reply.ok && reply.status !== 304) throw { code: reply.status, text: (await reply.text()).trim() };
  return reply;
}

function setState(kind, text) {
  $("state").dataset.state = kind;
  setText($("state-text"), text);
  if (live.state !== text) setText($("announcement"), `Run: ${text}`);
  live.state = text;
}

function metricsOf(status) {
  const metrics = {};
  for (const { name, value } of status.metrics) metrics[name] = value;
  return metrics;
}

function showTile(name, text, unit = "") {
  const tile = $(`tile-${name}`);
  if (tile.dataset.text === text + unit) return;
  tile.dataset.text = text + unit;
  tile.replaceChildren(text, ...(unit ? [make("small", "", unit)] : []));
}

function showProgress(metrics, rate, training) {
  const share = metrics.env_steps_goal > 0 ? Math.min(1, metrics.env_steps / metrics.env_steps_goal) : 0;
  const left = (metrics.env_steps_goal - metrics.env_steps) / rate;
  live.goal = metrics.env_steps_goal;
  $("progress").firstElementChild.style.transform = `translateX(${100 * (share - 1)}%)`;
  $("progress").setAttribute("aria-valuenow", decimals(100 * share, 0));
  setText($("progress-text"), `${whole.format(metrics.env_steps)} of ${whole.format(metrics.env_steps_goal)} steps, ` +
    `${decimals(100 * share, 1)} %, iteration ${whole.format(metrics.iteration)}`);
  showTile("left", share >= 1 ? "done" : training && rate > 0 ? span(left) : "–");
}

function showShares(times) {
  const shown = [...times].sort((a, b) => b.share - a.share).filter((time) => time.share >= 0.005);
  $("shares").replaceChildren(...shown.map((time) => {
    const part = make("span");
    part.style.width = `calc(${100 * time.share}% - 2px)`;
    part.style.background = `var(${activityColours[time.activity] ?? "--s8"})`;
    return part;
  }));
  $("share-list").replaceChildren(...shown.map((time) => {
    const swatch = make("i");
    swatch.style.background = `var(${activityColours[time.activity] ?? "--s8"})`;
    return make("li", "", swatch, time.activity, make("span", "figures", `${decimals(100 * time.share, 0)} %`));
  }));
}

// A worker's state and whether it is a good one.
function stateOf(peer) {
  if (peer.health === "LOST") return ["lost", "bad"];
  if (peer.health === "NOT_ANSWERING") return ["not answering", "bad"];
  if (peer.health === "SLOW") return ["slow", "bad"];
  if (peer.health === "LEFT") return ["left", ""];
  if (peer.drain === "DRAINING") return ["draining", ""];
  if (peer.drain === "DRAINED") return ["drained", ""];
  return ["ok", "ok"];
}

function workerRow() {
  const row = make("tr");
  const name = make("th", "name");
  name.scope = "row";
  row.append(name, make("td", "", make("span", "badge")), make("td", "number"), make("td", "number"), make("td", "number"),
    make("td", "number"), make("td", "number"), make("td"), make("td", "steer-column"));
  return row;
}

function showWorker(row, peer, published) {
  const [name, state, speed, lanes, lag, memory, seen, time, steer] = row.children;
  const summary = peer.summary ?? {};
  const role = peer.role === "envserver" ? "environment server" : peer.role;
  if (name.dataset.name !== peer.name + peer.address) {
    name.dataset.name = peer.name + peer.address;
    name.replaceChildren(peer.name || peer.address, make("small", "", role));
  }
  const [text, kind] = stateOf(peer);
  state.firstElementChild.className = `badge ${kind}`;
  setText(state.firstElementChild, text);
  state.title = peer.state;
  const behind = published - Number(summary.policy_version ?? -1);
  setText(speed, whole.format(summary.steps_per_second ?? 0));
  setText(lanes, String(summary.lanes ?? 0));
  setText(lag, peer.role === "actor" && summary.policy_version >= 0 ? String(Math.max(0, behind)) : "–");
  setText(memory, summary.memory_bytes > 0 ? `${whole.format(summary.memory_bytes / 2 ** 20)} MiB` : "–");
  setText(seen, peer.role === "learner" ? "–" : span(peer.last_seen_s));
  const busiest = [...(summary.times ?? [])].sort((a, b) => b.share - a.share).slice(0, 2);
  setText(time, busiest.map((part) => `${part.activity} ${decimals(100 * part.share, 0)} %`).join(", "));
  const drained = peer.drain && peer.drain !== "NO_DRAIN";
  const wanted = live.steer && peer.role !== "learner" && (["OK", "SLOW"].includes(peer.health) || drained) ? (drained ? "Undrain" : "Drain") : "";
  const worker = peer.name || peer.address;  // another one than before, once some join or leave
  const label = wanted && `${wanted} ${worker}`;
  if (steer.dataset.label === label) return;
  steer.dataset.label = label;
  steer.replaceChildren();
  if (!wanted) return;
  const button = make("button", "", wanted);
  button.type = "button";
  button.setAttribute("aria-label", label);
  button.addEventListener("click", () => steerRun(`${wanted.toLowerCase()}?worker=${encodeURIComponent(worker)}`));
  steer.append(button);
}

function showWorkers(status) {
  const self = { role: "learner", name: status.name, address: "", health: "OK", state: "", summary: status.summary, last_seen_s: 0 };
  const peers = [self, ...status.peers];
  const body = $("workers");
  while (body.children.length < peers.length) body.append(workerRow());
  while (body.children.length > peers.length) body.lastElementChild.remove();
  peers.forEach((peer, i) => showWorker(body.children[i], peer, Number(status.summary.policy_version)));
}

function showStatus(status) {
  const metrics = metricsOf(status);
  const state = status.fleet.run_state;
  const rate = status.summary.steps_per_second;
  live.paused = state === "PAUSED";
  setState((state ?? "").toLowerCase(), stateWords[state] ?? "Running");
  setText($("pause"), live.paused ? "Resume" : "Pause");
  $("pause").disabled = state !== "TRAINING" && state !== "PAUSED";
  $("checkpoint").disabled = state === "COMPLETE" || state === "EVALUATING";
  $("stop").disabled = live.stopping || state === "COMPLETE";
  showTile("score", decimals(metrics.crafter_score, 2));
  showTile("reward", decimals(metrics.reward, 2));
  showTile("unlocked", decimals(metrics.achievements_unlocked, 0), " / 22");
  showTile("speed", whole.format(rate));
  showTile("episodes", whole.format(metrics.episodes));
  showProgress(metrics, rate, state === "TRAINING");
  showShares(status.fleet.times);
  setText($("advice"), status.fleet.advice || " ");
  setText($("checkpoint-age"), `The last one was written ${span(metrics.checkpoint_age)} ago.`);
  showWorkers(status);
}

function describe(chart, name, value, end) {
  chart.canvas.setAttribute("aria-label", `${name}: ${value} after ${whole.format(end)} environment steps`);
}

// The end of the steps' axis: the goal, halved as long as the run is far from it.
function axisEnd(steps, goal) {
  let end = Math.max(goal, steps, 1);
  while (end > 2.4 * Math.max(steps, 1000)) end /= 2;
  return end;
}

function showCurves(data, views) {
  const { run, curve, speed } = data;
  const end = axisEnd(data.env_steps, live.goal);
  document.title = `${run.agent} on ${run.env} – CraftFleet`;
  setText($("run-title"), `${run.agent} on ${run.env}`);
  setText($("run-facts"), `Run ${run.id}, seed ${run.seed}, ${run.lanes} lanes`);
  show(views.score, [{ label: "this run", points: pointsOf(curve, "score"), colour: "--accent" }, ...levels(end)], end);
  show(views.reward, [{ label: "reward", points: pointsOf(curve, "reward"), colour: "--accent" }], end);
  show(views.speed, [{ label: "steps a second", points: pointsOf(speed, "rate"), colour: "--s2" }], end);
  describe(views.score.chart, "Crafter score", decimals(curve.score.at(-1) ?? 0, 2), data.env_steps);
  describe(views.reward.chart, "Reward", decimals(curve.reward.at(-1) ?? 0, 2), data.env_steps);
  describe(views.speed.chart, "Steps a second", whole.format(speed.rate.at(-1) ?? 0), data.env_steps);
  views.achievements(data.rates);
  $("checkpoints").replaceChildren(...data.checkpoints.map(({ name, steps }) =>
    make("li", "", make("span", "", name), make("span", "quiet", `${compact.format(steps)} steps`))));
}

async function showFrame(number, steps) {
  const picture = await (await ask("frame.png")).blob();
  const image = $("frame");
  const former = image.src;
  image.src = URL.createObjectURL(picture);
  await image.decode();
  if (former.startsWith("blob:")) URL.revokeObjectURL(former);
  image.alt = `What an agent sees after ${whole.format(steps)} steps: its surroundings and its inventory`;
  setText($("frame-text"), `One of the games, at ${whole.format(steps)} steps`);
  live.frame = number;
}

// Returns whether the learner obeys.
async function steerRun(path) {
  let done = false;
  try {
    const reply = await ask(path, { method: "POST", headers: { "X-Craftfleet": "page" } });
    setText($("message"), (await reply.text()).trim());
    done = true;
  } catch (error) {
    setText($("message"), error.text ?? "The learner does not answer.");
  }
  poll.now();
  return done;
}

// Asks first: whoever only meant to pause would lose the page.
function startStopping() {
  const dialog = $("stop-dialog");
  $("stop").addEventListener("click", () => dialog.showModal());
  $("stop-cancel").addEventListener("click", () => dialog.close());
  $("stop-confirm").addEventListener("click", async () => {
    dialog.close();
    live.stopping = await steerRun("stop");
  });
}

async function update(views) {
  const reply = await ask("status.json");
  const steer = reply.headers.get("X-Craftfleet-Steer") === "yes";
  const status = await reply.json();
  live.steer = steer;
  const restarted = live.learner !== status.name;  // what the page knows is of the learner before
  if ((restarted && live.stopping) || $("live").hidden || live.state === "Refused") setText($("message"), "");
  if (restarted) Object.assign(live, { learner: status.name, tag: "", frame: 0, stopping: false });
  $("steering").hidden = !steer;
  $("sign-in").hidden = true;
  $("live").hidden = false;
  showStatus(status);
  // Unless an iteration has ended since, the answer is 304.
  const curves = await ask("curves.json", live.tag ? { headers: { "If-None-Match": live.tag } } : {});
  if (curves.status === 304) return;
  const data = await curves.json();
  showCurves(data, views);
  if (data.frame && data.frame !== live.frame) await showFrame(data.frame, data.env_steps);
  live.tag = curves.headers.get("ETag");
}

function signIn(error) {
  $("live").hidden = true;
  $("steering").hidden = true;
  $("sign-in").hidden = false;
  setState("lost", "Token needed");
  setText($("message"), live.token ? "This token may not watch the run." : "");
  if (error.code === 401 || error.code === 403) sessionStorage.removeItem("token");
  live.token = "";
}

// Polls while the page is visible, one request at a time.
const poll = {
  timer: 0,
  busy: false,
  views: null,
  async now() {
    clearTimeout(poll.timer);
    if (poll.busy || document.hidden || !$("sign-in").hidden) return;
    poll.busy = true;
    try {
      await update(poll.views);
    } catch (error) {
      if (error.code === 401 || (error.code === 403 && live.token)) {
        signIn(error);
      } else {
        // Without a token, the server refuses the name by which the browser knows it, and says what to do.
        const refused = error.code === 403;
        if (refused) setText($("message"), error.text);
        setState("lost", live.stopping ? "Stopped" : refused ? "Refused" : "No answer");
      }
    }
    poll.busy = false;
    poll.timer = setTimeout(poll.now, kPollMs);
  },
};

function startLive() {
  $("live").hidden = false;
  setText($("sources"), references.sources);
  poll.views = {
    score: lineChart($("score-chart"), { legend: true }),
    reward: lineChart($("reward-chart")),
    speed: lineChart($("speed-chart")),
    achievements: achievementBars($("achievements")),
  };
  // A link may have the token behind "#", which browsers do not send.
  const link = new URLSearchParams(location.hash.slice(1).replaceAll("+", "%2B")).get("token");  // else "+" is a blank
  if (link) {
    sessionStorage.setItem("token", link);
    history.replaceState(null, "", location.pathname);
  }
  live.token = sessionStorage.getItem("token") ?? "";
  $("sign-in").addEventListener("submit", (event) => {
    event.preventDefault();
    live.token = $("token").value.trim();
    sessionStorage.setItem("token", live.token);
    $("token").value = "";
    $("sign-in").hidden = true;
    poll.now();
  });
  $("pause").addEventListener("click", () => steerRun(live.paused ? "resume" : "pause"));
  $("checkpoint").addEventListener("click", () => steerRun("checkpoint"));
  startStopping();
  document.addEventListener("visibilitychange", poll.now);
  poll.now();
}

startLive();
