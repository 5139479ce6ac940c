// A report: finished runs side by side. Decides at the end whether this page is one, or live.

const kMaxShown = 8;  // runs in the charts: as many colours as there are
const columns = [
  { name: "Run", value: (run) => run.name, text: (run) => breakable(run.name) },
  { name: "Score", value: (run) => run.score, text: (run) => decimals(run.score, 2), number: true },
  { name: "Reward", value: (run) => run.reward, text: (run) => decimals(run.reward, 2), number: true },
  { name: "Evaluation", value: (run) => run.evaluation ?? -1, text: (run) => (run.evaluation === null ? "–" : decimals(run.evaluation, 2)), number: true },
  { name: "Unlocked", value: (run) => run.unlocked, text: (run) => `${run.unlocked} / 22`, number: true },
  { name: "Steps", value: (run) => run.steps, text: (run) => compact.format(run.steps) + (run.complete ? "" : " (unfinished)"), number: true },
  { name: "Agent", value: (run) => run.agent, text: (run) => run.agent },
  { name: "Environment", value: (run) => run.env, text: (run) => run.env },
  { name: "Seed", value: (run) => run.seed, text: (run) => String(run.seed), number: true },
];
const board = { runs: [], by: 1, down: true };

const isShown = (run) => run.slot !== null;

// Gives the run a colour, or takes it away; refuses when all are in use.
function toggle(run) {
  const used = new Set(board.runs.map(({ slot }) => slot));
  const free = [...Array(kMaxShown).keys()].find((slot) => !used.has(slot));
  if (!isShown(run) && free === undefined) {
    setText($("message"), `At most ${kMaxShown} runs fit into the charts: take one out first.`);
    return;
  }
  run.slot = isShown(run) ? null : free;
  setText($("message"), "");
  showRuns();
}

function compare(a, b) {
  const [x, y] = [a, b].map(columns[board.by].value);
  const order = typeof x === "string" ? x.localeCompare(y, "en", { numeric: true }) : x - y;
  return board.down ? -order : order;
}

function leaderboardRow(run) {
  const box = make("input");
  box.type = "checkbox";
  box.checked = isShown(run);
  box.setAttribute("aria-label", `Show ${run.name} in the charts`);
  box.addEventListener("change", () => {
    toggle(run);
    box.checked = isShown(run);
  });
  run.swatch = make("i", "swatch");
  const [first, ...rest] = columns;
  const name = make("th", "", first.text(run));
  name.scope = "row";
  return make("tr", "", make("td", "pick", box, run.swatch), name,
    ...rest.map(({ text, number }) => make("td", number ? "number" : "", text(run))));
}

function leaderboard() {
  const head = make("tr", "", make("th", "", make("span", "unseen", "In the charts")));
  const body = make("tbody");
  const fill = () => body.replaceChildren(...[...board.runs].sort(compare).map((run) => run.row));
  columns.forEach(({ name, number }, i) => {
    const button = make("button", "sort", name);
    button.type = "button";
    const cell = make("th", number ? "number" : "", button);
    cell.scope = "col";
    button.addEventListener("click", () => {
      board.down = board.by === i ? !board.down : Boolean(number);
      board.by = i;
      mark();
      fill();
    });
    head.append(cell);
  });
  const mark = () => [...head.children].slice(1).forEach((cell, i) => {
    if (i === board.by) cell.setAttribute("aria-sort", board.down ? "descending" : "ascending");
    else cell.removeAttribute("aria-sort");
  });
  for (const run of board.runs) run.row = leaderboardRow(run);
  mark();
  fill();
  return make("table", "leaderboard", make("thead", "", head), body);
}

// Success rates: a row for each achievement, a column for each shown run.
function rateTable(runs) {
  const others = [["PPO", "ppo"], ["random", "random"]];
  const heads = [...runs.map((run) => make("th", "number", swatchOf(run), breakable(run.name))), ...others.map(([name]) => make("th", "number quiet", name))];
  heads.forEach((cell) => { cell.scope = "col"; });
  const body = Object.entries(references.rates).map(([name, known]) => {
    const head = make("th", "", words(name));
    head.scope = "row";
    const cells = runs.map(({ rates }) => {
      const cell = make("td", "number heat", percent(rates[name]));
      cell.style.setProperty("--share", `${Math.sqrt(rates[name] / 100) * 45}%`);
      return cell;
    });
    return make("tr", "", head, ...cells, ...others.map(([, key]) => make("td", "number quiet", percent(known[key]))));
  });
  return make("table", "", make("thead", "", make("tr", "", make("th", "", make("span", "unseen", "Achievement")), ...heads)), make("tbody", "", ...body));
}

function swatchOf(run) {
  const swatch = make("i", "swatch");
  swatch.style.background = `var(--s${run.slot + 1})`;
  return swatch;
}

function showRuns() {
  const shown = board.runs.filter(isShown).sort((a, b) => b.score - a.score);
  const end = Math.max(1, ...shown.map(({ curve }) => curve.steps.at(-1) ?? 0));
  for (const run of board.runs) run.swatch.style.background = isShown(run) ? `var(--s${run.slot + 1})` : "transparent";
  const lines = (name) => shown.map((run) => ({ label: run.name, points: pointsOf(run.curve, name), colour: `--s${run.slot + 1}` }));
  show(board.score, [...lines("score"), ...levels(end)], end);
  show(board.reward, lines("reward"), end);
  const list = shown.map((run) => `${run.name} ${decimals(run.score, 2)}`).join(", ");
  board.score.chart.canvas.setAttribute("aria-label", `Crafter score over environment steps; at the end: ${list}`);
  $("rates").replaceChildren(rateTable(shown));
}

function section(title, className, ...children) {
  const head = make("h2", "", title);
  head.id = `report-${title.replace(/\W+/g, "-").toLowerCase()}`;
  const part = make("section", `card ${className}`, head, ...children);
  part.setAttribute("aria-labelledby", head.id);
  return part;
}

function scrollable(label, ...children) {
  const box = make("div", "scroll", ...children);
  box.tabIndex = 0;
  box.setAttribute("role", "region");
  box.setAttribute("aria-label", label);
  return box;
}

function chartBox(label) {
  const canvas = make("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", label);
  return [canvas, make("div", "chart", canvas)];
}

function startReport(report) {
  board.runs = report.runs.map((run) => ({ ...run, slot: null }));
  [...board.runs].sort((a, b) => b.score - a.score).slice(0, kMaxShown).forEach((run, i) => { run.slot = i; });
  const complete = board.runs.filter((run) => run.complete).length;
  const [scoreCanvas, scoreBox] = chartBox("Crafter score over environment steps");
  const [rewardCanvas, rewardBox] = chartBox("Reward over environment steps");
  const rates = make("div");
  rates.id = "rates";
  document.title = "CraftFleet – report";
  $("state").dataset.state = "complete";
  setText($("state-text"), "Report");
  $("report-view").append(
    make("div", "title", make("h1", "", board.runs.length === 1 ? board.runs[0].name : `${board.runs.length} runs`),
      make("p", "quiet", `${complete} of ${board.runs.length} complete. Scores are Crafter scores of all training episodes; evaluations are sampled.`)),
    make("div", "grid",
      section("Leaderboard", "full", scrollable("Leaderboard", leaderboard())),
      section("Score", "half", scoreBox),
      section("Reward, mean of the last 100 episodes", "half", rewardBox),
      section("Achievements", "full", make("p", "quiet", `Share of the training episodes that unlock each one. PPO and random play: ${references.sources}`),
        scrollable("Achievements", rates))));
  $("report-view").hidden = false;
  board.score = lineChart(scoreCanvas, { legend: true });
  board.reward = lineChart(rewardCanvas);
  showRuns();
}

const report = jsonOf("report");
if (report === null) startLive();
else startReport(report);
