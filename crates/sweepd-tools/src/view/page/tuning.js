// The segmenter's options as sliders. A change is sent at once; what differs from what holds now is what is sent.

/** Position of a slider, 0 to 1, by steps. */
const STEPS = 1000;

export class Tuning {
  /** `send` takes what is to be done; `compare` is called when `mode` is another: "before", "after" or "both". */
  constructor(root, send, compare) {
    this.root = root;
    this.send = send;
    this.compare = compare;
    this.rows = new Map();
    this.method = null;
    this.known = "";
    this.active = false;
    const part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.list = part("settings");
    this.methods = part("method");
    this.refused = part("refused");
    this.summary = part("summary");
    this.base = part("base");
    this.masked = part("masked");
    this.floor = part("floor");
    this.trouble = part("trouble");
    this.reset = part("reset");
    this.modes = [...root.querySelectorAll("[data-compare]")];
    this.methods.addEventListener("change", () => this.changed());
    this.reset.addEventListener("click", () => this.end());
    part("copy").addEventListener("click", () => this.send({ do: "configuration" }));
    for (const mode of this.modes) mode.addEventListener("click", () => this.choose(mode.dataset.compare));
    this.text = part("configuration");
    this.choose("before");
  }

  /** Takes the options of the source. Those that were changed stay, unless the options are others. */
  source({ kind, told, masked, settings, methods, method, floor }) {
    this.base.hidden = kind !== "sensor" || told;
    this.masked.hidden = !masked;
    const { lines, trouble } = floor ?? {};
    this.floor.textContent = lines ?? "";
    this.floor.hidden = !lines;
    this.trouble.textContent = trouble ?? "";
    this.trouble.hidden = !trouble;
    const key = JSON.stringify([settings, methods, method]);
    if (key === this.known) return;
    this.known = key;
    const chosen = this.active ? this.differing : {};
    this.rows.clear();
    this.list.replaceChildren();
    const methodChosen = this.active ? this.methods.value : undefined;
    this.methods.replaceChildren(...(methods ?? []).map((name) => new Option(name, name)));
    this.methodNow = method ?? methods?.[0];
    this.methods.value = methodChosen ?? this.methodNow ?? "";
    for (const setting of settings ?? []) this.rows.set(setting.key, this.row(setting));
    for (const [name, value] of Object.entries(chosen)) {
      const row = this.rows.get(name);
      if (row !== undefined) this.put(row, value);
    }
    if (this.active) this.changed();
    this.settle();
  }

  row(setting) {
    const { key, unit, least, what } = setting;
    const most = reachOf(setting);
    const line = document.createElement("div");
    line.className = "setting";
    line.dataset.key = key;
    line.title = what;
    const name = document.createElement("label");
    name.textContent = key.replace(/_(deg|m)$/, "").replaceAll("_", " ");
    const slider = document.createElement("input");
    Object.assign(slider, { type: "range", min: 0, max: STEPS, step: 1, id: `slider-${key}` });
    name.htmlFor = slider.id;
    const number = document.createElement("input");
    Object.assign(number, { type: "number", min: least, max: setting.most, step: "any" });
    number.setAttribute("aria-label", `${name.textContent} as a number`);
    const units = document.createElement("span");
    units.textContent = unit === "deg" ? "°" : unit;
    const back = document.createElement("button");
    back.className = "quiet";
    back.textContent = "↺";
    back.title = "as it is now";
    back.setAttribute("aria-label", `${name.textContent} as it is now`);
    line.append(name, slider, number, units, back);
    this.list.append(line);
    const now = setting.now ?? null;
    const row = { setting, line, slider, number, now, value: now, curve: curveOf(setting, most) };
    this.put(row, now);
    slider.addEventListener("input", () => {
      this.put(row, rounded(row.curve.value(slider.valueAsNumber / STEPS), setting, most), true);
      this.changed();
    });
    number.addEventListener("change", () => {
      const typed = number.valueAsNumber;
      const empty = setting.absent ? null : now;
      this.put(row, Number.isNaN(typed) ? empty : Math.min(setting.most, Math.max(least, typed)));
      this.changed();
    });
    back.addEventListener("click", () => {
      this.put(row, now);
      this.changed();
    });
    return row;
  }

  /** Shows a value; null is "by itself". */
  put(row, value, fromSlider = false) {
    row.value = value;
    row.number.value = value === null ? "" : String(value);
    row.number.placeholder = row.setting.absent ? "auto" : "";
    if (!fromSlider) row.slider.value = String(Math.round(STEPS * row.curve.place(value ?? row.setting.default ?? row.setting.least)));
    row.line.classList.toggle("changed", value !== row.now);
  }

  /** Whether an option is read by the chosen method: theta is of the paper's alone. */
  isRead({ setting }) {
    return setting.key !== "theta_deg" || this.methods.value === "paper";
  }

  /** Options that differ from what holds now. */
  get differing() {
    const entries = [...this.rows.values()].filter((row) => row.value !== row.now && this.isRead(row));
    return Object.fromEntries(entries.map((row) => [row.setting.key, row.value]));
  }

  changed() {
    const settings = this.differing;
    this.refused.hidden = true;
    this.text.hidden = true;
    if (Object.keys(settings).length === 0 && this.methods.value === this.methodNow) return this.end();
    this.send({ do: "tune", method: this.methods.value, settings });
    if (!this.active) {
      this.active = true;
      if (this.mode === "before") this.choose("after");
    }
    this.settle();
  }

  /** Back to what holds. */
  end() {
    for (const row of this.rows.values()) this.put(row, row.now);
    if (this.methodNow !== undefined) this.methods.value = this.methodNow;
    if (this.active) this.send({ do: "tune", settings: null });
    this.active = false;
    this.summary.textContent = "";
    this.refused.hidden = true;
    this.text.hidden = true;
    this.choose("before");
  }

  /** After the connection came back: what is tuned is asked for again. */
  again() {
    if (this.active) this.send({ do: "tune", method: this.methods.value, settings: this.differing });
  }

  choose(mode) {
    this.mode = this.active ? mode : "before";
    this.settle();
    this.compare();
  }

  toggle() {
    if (this.active) this.choose(this.mode === "after" ? "before" : "after");
  }

  settle() {
    this.root.classList.toggle("active", this.active);
    this.reset.disabled = !this.active;
    for (const row of this.rows.values()) row.line.hidden = !this.isRead(row);
    for (const button of this.modes) {
      button.disabled = !this.active;
      button.setAttribute("aria-pressed", String(button.dataset.compare === this.mode));
    }
  }

  refuse(text) {
    this.refused.textContent = text;
    this.refused.hidden = false;
  }

  /** What the change did. */
  compareCounts(before, after) {
    const share = ({ header }) => `${((100 * header.ground) / Math.max(1, header.returns)).toFixed(1)} %`;
    this.summary.textContent =
      `segments ${before.segments.length} → ${after.segments.length}, ground ${share(before)} → ${share(after)}`;
  }

  /** The lines of the configuration: shown, and copied where the browser lets us. */
  async configuration(text) {
    this.text.textContent = text;
    this.text.hidden = false;
    try {
      await navigator.clipboard.writeText(text);
      this.refused.hidden = true;
    } catch {
      // Without leave for the clipboard, the lines are there to be selected.
      getSelection().selectAllChildren(this.text);
    }
  }
}

/** How far a slider goes: counts without a limit of their own go to some times what is usual. */
function reachOf({ least, most, default: usual }) {
  return most > 100000 ? Math.max(least + 100, 20 * (usual ?? least)) : most;
}

/** How values lie on a slider: those around the usual one have the most room. */
function curveOf({ least, default: usual }, most) {
  if (least === -most) {
    return {
      value: (part) => Math.sign(part - 0.5) * (2 * part - 1) ** 2 * most,
      place: (value) => 0.5 + (Math.sign(value) * Math.sqrt(Math.abs(value) / most)) / 2,
    };
  }
  const share = usual > least ? (usual - least) / (most - least) : most - least > 100 ? 0.02 : 0.3;
  const power = Math.min(5, Math.max(1, Math.log(share) / Math.log(1 / 3)));
  return {
    value: (part) => least + (most - least) * part ** power,
    place: (value) => Math.max(0, Math.min(1, (value - least) / (most - least))) ** (1 / power),
  };
}

/** Whole counts; else as many decimals as a step of the slider is fine. */
function rounded(value, { unit, least, most }, reach) {
  const decimals = unit === "" ? 0 : reach <= 1 ? 3 : reach <= 10 ? 2 : 1;
  return Math.min(most, Math.max(least, Number(value.toFixed(decimals))));
}
