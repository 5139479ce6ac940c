"""Pages in headless Chromium, by Selenium; both are Debian packages (deploy/install-deps.sh --tests)."""

import importlib.util
import os
import pathlib
import shutil
import sys
import tempfile
import unittest

SYSTEM_PYTHON = "/usr/bin/python3"  # has Debian's Selenium, whichever Python comes first

if importlib.util.find_spec("selenium") is None and sys.executable != SYSTEM_PYTHON and os.access(SYSTEM_PYTHON, os.X_OK):
  os.execv(SYSTEM_PYTHON, [SYSTEM_PYTHON, *sys.orig_argv[1:]])

# Lets the page count each move of an element that nobody caused, and every error of its scripts.
COUNT_SHIFTS = """
window.shifts = [];
new PerformanceObserver((list) => list.getEntries().forEach((entry) => window.shifts.push({
  value: entry.value, nodes: entry.sources.map(({ node }) => node && (node.id || node.className || node.nodeName)) })))
  .observe({ type: "layout-shift", buffered: true });
"""

# The texts whose contrast to what is behind them is below AA's: 4.5, or 3 for large ones.
LOW_CONTRAST = """
const canvas = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
const rgba = (colour) => {
  canvas.clearRect(0, 0, 1, 1);
  canvas.fillStyle = colour;
  canvas.fillRect(0, 0, 1, 1);
  return [...canvas.getImageData(0, 0, 1, 1).data].map((value) => value / 255);
};
const over = (top, below) => top.slice(0, 3).map((value, i) => value * top[3] + below[i] * (1 - top[3]));
const behind = (element) => {
  const layers = [];
  for (let at = element; at; at = at.parentElement) layers.push(rgba(getComputedStyle(at).backgroundColor));
  return layers.reverse().reduce((below, layer) => over(layer, below), [1, 1, 1]);
};
const light = (colour) => colour.map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
  .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
const found = [];
for (const element of document.querySelectorAll("body *")) {
  const text = [...element.childNodes].filter((node) => node.nodeType === 3).map((node) => node.data.trim()).join("");
  if (!text || !element.checkVisibility() || element.closest(".unseen, script, noscript, button:disabled")) continue;
  const style = getComputedStyle(element);
  const ground = behind(element);
  const [a, b] = [light(over(rgba(style.color), ground)), light(ground)];
  const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  const size = parseFloat(style.fontSize);
  const large = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
  if (ratio < (large ? 3 : 4.5)) found.push(`${ratio.toFixed(2)}: ${text.slice(0, 40)} (${element.id || element.className || element.nodeName})`);
}
return found;
"""

# Calls back once charts have taken their sizes and are drawn.
TWO_FRAMES = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 100)));"

# Everything that a keyboard must reach, and the rest of what it may.
CONTROLS = """
return [...document.querySelectorAll("a[href], button:not(:disabled), input:not(:disabled), [tabindex='0']")]
  .filter((element) => element.checkVisibility());
"""

# What scrolls within the page but cannot be focused: not every browser lets the keyboard scroll that.
MOUSE_SCROLLERS = """
return [...document.querySelectorAll("body *")].filter((element) => {
  const scrolls = (overflow, inner, outer) => /auto|scroll/.test(overflow) && inner > outer + 1;
  const style = getComputedStyle(element);
  return (scrolls(style.overflowY, element.scrollHeight, element.clientHeight) ||
          scrolls(style.overflowX, element.scrollWidth, element.clientWidth)) && element.tabIndex < 0;
}).map((element) => element.outerHTML.slice(0, 100));
"""


def open_browser(case):
  """The browser of the class of the test `case`, with an empty page. Skips the test if it is not installed."""
  kind = type(case)
  if not hasattr(kind, "browser"):
    kind.browser = _start(kind)
  driver = kind.browser
  driver.get("about:blank")
  driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
  driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
  errors(driver)  # those of the test before
  return driver


def _start(kind):
  """A browser that is closed after the last test of the class `kind`."""
  driver_path = shutil.which("chromedriver")
  if importlib.util.find_spec("selenium") is None or driver_path is None or shutil.which("chromium") is None:
    raise unittest.SkipTest("Chromium or Selenium is missing, want: deploy/install-deps.sh --tests")
  from selenium import webdriver  # pylint: disable=import-outside-toplevel
  from selenium.webdriver.chrome.service import Service  # pylint: disable=import-outside-toplevel
  options = webdriver.ChromeOptions()
  options.binary_location = shutil.which("chromium")
  profile = tempfile.TemporaryDirectory(prefix="craftfleet-chromium-")  # pylint: disable=consider-using-with
  kind.addClassCleanup(profile.cleanup)
  for argument in ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--no-first-run",
                   f"--user-data-dir={profile.name}"]:
    options.add_argument(argument)
  options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
  options.set_capability("acceptInsecureCerts", True)
  driver = webdriver.Chrome(service=Service(driver_path), options=options)
  kind.addClassCleanup(driver.quit)
  driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": COUNT_SHIFTS})
  return driver


def look(driver, width, dark=False, height=900):
  """Shows the page as a screen of this width in CSS pixels does."""
  driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                         {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600})
  scheme = "dark" if dark else "light"
  driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})


def errors(driver):
  """What the browser's console says since the last call, apart from refusals by the server that the test asked for."""
  return [line["message"] for line in driver.get_log("browser")]


def save(driver, name):
  """Keeps a picture of the whole page in the folder CRAFTFLEET_SCREENSHOTS, if that is set; returns its PNG file."""
  import base64  # pylint: disable=import-outside-toplevel
  width, height = driver.execute_script("return [innerWidth, document.documentElement.scrollHeight]")
  driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                         {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600})
  driver.execute_async_script(TWO_FRAMES)
  png = base64.b64decode(driver.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"])
  folder = os.environ.get("CRAFTFLEET_SCREENSHOTS")
  if folder:
    pathlib.Path(folder, f"{name}.png").write_bytes(png)
  return png


def press(driver, key):
  """Presses a key, such as "ENTER", where the focus is."""
  from selenium.webdriver.common.action_chains import ActionChains  # pylint: disable=import-outside-toplevel
  from selenium.webdriver.common.keys import Keys  # pylint: disable=import-outside-toplevel
  ActionChains(driver).send_keys(getattr(Keys, key)).perform()


def tab_through(driver):
  """Presses Tab until the focus is back; the elements that had it, each with whether its focus can be seen."""
  driver.execute_script("document.activeElement.blur()")
  reached = []
  for _ in range(200):
    press(driver, "TAB")
    element = driver.switch_to.active_element
    if element.tag_name == "body" or element in reached:
      break
    reached.append(element)
  return reached
