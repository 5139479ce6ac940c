"""The live page in a browser, and its port over TLS."""

import hashlib
import http.client
import re
import ssl
import subprocess

from tests.deploy import browser
from tests.fakes import python_case
from tests.fakes.python_case import SOURCE, wait_until

LONG_GAMES = python_case.ENDLESS.replace("length: 20", "length: 200")
LOOKS = [(390, False), (390, True), (1440, False), (1440, True)]
TEXT = "return document.getElementById(arguments[0]).textContent"
# [the worker's name, the button's label] of each row with a button.
STEERED = """
return [...document.querySelectorAll("#workers button")].map((button) =>
  [button.closest("tr").querySelector("th").firstChild.textContent, button.ariaLabel]);
"""


class LivePage(python_case.ProcessCase):

  def start_run(self, program="craftfleet train", *flags):
    """Starts an endless run with a page; returns the page's URL and the log."""
    (self.folder / "config.txt").write_text(LONG_GAMES)
    _, log = self.start(program, f"--config={self.folder}/config.txt", f"--logdir={self.folder}/run", "--threads=1",
                        "--http_listen=127.0.0.1:0", *flags)
    return self.word_after(log, "live page on "), log

  def start_without_actor(self):
    """A learner and an environment server; returns the page's URL and the learner's address."""
    url, log = self.start_run("craftfleet-learner", "--listen=127.0.0.1:0")
    learner = self.word_after(log, "listening on ")
    self.start("craftfleet-envserver", "--listen=127.0.0.1:0", f"--learner={learner}")
    return url, learner

  def start_actor(self, learner):
    self.start("craftfleet-actor", f"--learner={learner}", "--envservers=learner", "--threads=1")

  def start_fleet(self):
    url, learner = self.start_without_actor()
    self.start_actor(learner)
    return url

  def text(self, driver, element):
    return driver.execute_script(TEXT, element)

  def wait_for_text(self, driver, element, pattern):
    return wait_until(lambda: re.search(pattern, self.text(driver, element)), f"{pattern} in #{element}")

  def wait_for_iterations(self, driver, count):
    """Waits until the page has shown `count` further iterations."""
    for _ in range(count):
      before = self.text(driver, "progress-text")
      wait_until(lambda shown=before: self.text(driver, "progress-text") != shown, "the page to go on")

  def check_looks(self, driver, name):
    """Readable in every look, without scrolling sideways."""
    for width, dark in LOOKS:
      browser.look(driver, width, dark)
      self.assertEqual(driver.execute_script(browser.LOW_CONTRAST), [], (width, dark))
      self.assertLessEqual(driver.execute_script("return document.documentElement.scrollWidth"), width)
      self.assertGreater(len(browser.save(driver, f"{name}-{width}-{'dark' if dark else 'light'}")), 10000)

  def check_keyboard(self, driver):
    controls = driver.execute_script(browser.CONTROLS)
    reached = browser.tab_through(driver)
    missed = [element.get_attribute("outerHTML")[:100] for element in controls if element not in reached]
    self.assertEqual(missed, [])
    self.assertEqual(driver.execute_script(browser.MOUSE_SCROLLERS), [])
    self.assertGreater(len(reached), 2)

  def test_the_page_follows_a_run_without_errors_or_shifts(self):
    driver = browser.open_browser(self)
    browser.look(driver, 1440)
    url, _ = self.start_run()
    driver.get(url)
    self.wait_for_text(driver, "state-text", "Training")
    self.wait_for_text(driver, "frame-text", r"at [\d,]+ steps")
    driver.execute_script("window.shifts = []")
    self.wait_for_iterations(driver, 4)
    self.assertEqual(driver.execute_script("return window.shifts"), [])
    browser.look(driver, 390)
    driver.execute_script("window.shifts = []")
    self.wait_for_iterations(driver, 3)
    self.assertEqual(driver.execute_script("return window.shifts"), [])
    self.assertGreater(driver.execute_script("return document.getElementById('frame').naturalWidth"), 10)
    self.assertRegex(self.text(driver, "tile-episodes"), r"[1-9]")
    self.assertEqual(len(driver.find_elements("css selector", ".achievement")), 22)
    self.assertEqual(browser.errors(driver), [])

  def test_the_page_is_readable_everywhere(self):
    driver = browser.open_browser(self)
    driver.get(self.start_fleet())
    self.wait_for_text(driver, "workers", "environment server")
    self.wait_for_text(driver, "workers", "actor")
    wait_until(lambda: len(driver.find_elements("css selector", "#checkpoints li")) > 6, "a list of checkpoints that scrolls")
    self.check_looks(driver, "live")
    self.check_keyboard(driver)
    self.assertEqual(browser.errors(driver), [])

  def test_buttons_steer_the_run(self):
    driver = browser.open_browser(self)
    driver.get(self.start_fleet())
    self.wait_for_text(driver, "workers", "actor")
    driver.find_element("id", "pause").click()
    self.wait_for_text(driver, "state-text", "Paused")
    self.assertIn("Paused", self.text(driver, "announcement"))
    self.wait_for_text(driver, "pause", "Resume")
    driver.find_element("id", "pause").click()
    self.wait_for_text(driver, "state-text", "Training")
    driver.find_element("id", "checkpoint").click()
    self.wait_for_text(driver, "message", "checkpoint will be written")
    drain = wait_until(lambda: driver.find_elements("css selector", "[aria-label^='Drain']"), "a button to drain")
    drain[0].click()
    self.wait_for_text(driver, "workers", "drained")
    driver.find_element("css selector", "[aria-label^='Undrain']").click()
    wait_until(lambda: "drain" not in self.text(driver, "workers"), "the worker to work again")
    self.assertEqual(browser.errors(driver), [])

  def test_each_button_steers_the_worker_of_its_row(self):
    driver = browser.open_browser(self)
    url, learner = self.start_without_actor()
    driver.get(url)
    wait_until(lambda: driver.execute_script(STEERED), "a button to drain the server")
    self.start_actor(learner)  # it takes the server's row
    wait_until(lambda: len(driver.execute_script(STEERED)) == 2, "a button to drain the actor")
    for name, label in driver.execute_script(STEERED):
      self.assertEqual(label, f"Drain {name}")

  def test_stopping_asks_first_and_ends_the_learner_with_a_checkpoint(self):
    driver = browser.open_browser(self)
    url, log = self.start_run()
    driver.get(url)
    self.wait_for_text(driver, "state-text", "Training")
    dialog = driver.find_element("id", "stop-dialog")
    focused = lambda: driver.switch_to.active_element.get_attribute("id")
    for way_out in ["ESCAPE", "ENTER"]:
      driver.execute_script("document.getElementById('stop').focus()")
      browser.press(driver, "ENTER")
      self.assertTrue(dialog.is_displayed())
      self.assertEqual(focused(), "stop-cancel", "nothing is stopped by pressing Enter twice")
      browser.press(driver, way_out)
      self.assertFalse(dialog.is_displayed())
      self.assertEqual(focused(), "stop")
    self.assertNotIn(": stop", log.read_text())
    browser.press(driver, "SPACE")
    self.check_looks(driver, "stop")
    browser.press(driver, "TAB")
    self.assertEqual(focused(), "stop-confirm")
    self.assertEqual(browser.errors(driver), [])
    browser.press(driver, "ENTER")
    self.wait_for_text(driver, "message", "checkpoint")
    wait_until(lambda: "resume" in log.read_text().split(": stop")[-1], "the learner's last words")
    self.wait_for_text(driver, "state-text", "Stopped")
    self.assertGreater(len(list((self.folder / "run/checkpoints").glob("iter-*"))), 0)
    self.start_run("craftfleet train", f"--http_listen={url.split('/')[2]}", "--resume")
    self.wait_for_text(driver, "state-text", "Training")
    self.assertTrue(driver.find_element("id", "stop").is_enabled(), "the run that goes on can be stopped too")
    self.assertEqual(self.text(driver, "message"), "")

  def start_secured(self):
    """A run whose page is beyond loopback; returns its port and the log."""
    subprocess.run([SOURCE / "deploy/make-certs.sh", self.folder / "certs", "learner"], check=True, capture_output=True)
    clients = [("watcher", "right: WATCH"), ("st+eerer", "right: WATCH right: STEER")]
    (self.folder / "access.txt").write_text("".join(
        f'client {{ name: "{token[-6:]}" token_sha256: "{hashlib.sha256(token.encode()).hexdigest()}" {rights} }}\n'
        for token, rights in clients))
    certs = self.folder / "certs"
    url, log = self.start_run("craftfleet-learner", "--listen=127.0.0.1:0", "--http_listen=0.0.0.0:0",
                              f"--tls_ca={certs}/ca.pem", f"--tls_cert={certs}/learner.pem",
                              f"--tls_key={certs}/learner.key", f"--access_file={self.folder}/access.txt")
    self.assertTrue(url.startswith("https://0.0.0.0:"), url)
    return int(url.rstrip("/").rsplit(":", 1)[1]), log

  def status_code(self, port, token):
    """Of a request for the status, over TLS with the authority checked."""
    context = ssl.create_default_context(cafile=str(self.folder / "certs/ca.pem"))
    connection = http.client.HTTPSConnection("localhost", port, context=context, timeout=20)
    connection.request("GET", "/status.json", headers={"Authorization": f"Bearer {token}"} if token else {})
    return connection.getresponse().status

  def test_a_secured_page_speaks_tls_alone_and_uses_a_new_certificate_at_once(self):
    port, log = self.start_secured()
    plain = http.client.HTTPConnection("localhost", port, timeout=20)
    plain.request("GET", "/")
    with self.assertRaises((http.client.BadStatusLine, ConnectionError)):
      plain.getresponse()
    before = ssl.get_server_certificate(("localhost", port))
    subprocess.run([SOURCE / "deploy/make-certs.sh", self.folder / "certs", "learner"], check=True, capture_output=True)
    wait_until(lambda: ssl.get_server_certificate(("localhost", port)) != before, "the new certificate")
    for token, code in ((None, 401), ("wrong", 401), ("watcher", 200)):
      self.assertEqual(self.status_code(port, token), code)
    self.assertIn("new certificate", log.read_text())

  def test_a_page_under_an_unknown_name_says_what_to_do(self):
    driver = browser.open_browser(self)
    url, _ = self.start_run()
    driver.get(url.replace("127.0.0.1", "other.localhost"))
    self.wait_for_text(driver, "message", "--http_hosts=other.localhost")
    self.wait_for_text(driver, "state-text", "Refused")
    self.assertFalse(driver.find_element("id", "sign-in").is_displayed())

  def test_the_page_asks_for_the_token(self):
    driver = browser.open_browser(self)
    port, _ = self.start_secured()
    url = f"https://localhost:{port}/"
    driver.get(url)
    wait_until(lambda: driver.find_element("id", "token").is_displayed(), "the question for the token")
    self.assertFalse(driver.find_element("id", "live").is_displayed())
    self.check_looks(driver, "token")
    self.check_keyboard(driver)
    for token, shown in [("wrong", False), ("watcher", True)]:
      field = wait_until(lambda: [driver.find_element("id", "token")] if driver.find_element("id", "token").is_displayed() else [],
                         "the question for the token")[0]
      field.send_keys(token + "\n")
      wait_until(lambda wanted=shown: driver.find_element("id", "live").is_displayed() == wanted and
                 driver.find_element("id", "sign-in").is_displayed() != wanted, token)
    self.wait_for_text(driver, "state-text", "Training")
    self.assertEqual(self.text(driver, "message"), "", "nothing about the wrong token")
    for button in ["pause", "stop"]:
      self.assertFalse(driver.find_element("id", button).is_displayed())
    driver.execute_script("sessionStorage.clear()")
    driver.get("about:blank")
    driver.get(url + "#token=st+eerer")
    wait_until(lambda: driver.find_element("id", "pause").is_displayed(), "the buttons of those who may steer")
    self.assertEqual(driver.current_url, url)


python_case.main()
