"""craftfleet envs and agents: the environments of the paper with the objects in their worlds, and the agents with their sizes."""

import json
import re

from tests.fakes import python_case

# Counts of tree, coal, cow, zombie and skeleton over 300 worlds. Source: measured with the published environment.
COUNTS = {
    "crafter": (189.8, 51.9, 26.1, 14.6, 9.7),
    "crafter:numbers=easy-x2": (380.3, 104.0, 46.0, 6.2, 4.4),
    "crafter:numbers=easy-x4": (761.7, 208.0, 103.0, 3.1, 2.1),
    "crafter:numbers=hard-x2": (94.5, 27.8, 13.0, 32.5, 19.0),
    "crafter:numbers=hard-x4": (51.7, 13.0, 6.1, 89.1, 37.9),
    "crafter:numbers=mix": (761.7, 208.0, 103.2, 60.2, 37.9),
    "crafter:inventory=off": (189.8, 51.9, 26.1, 14.6, 9.7),  # the same worlds
}

# Of each agent. oc_sa has a CLS token of 9,216 parameters more than the published code. Source: AGENTS.md, section 1.
PARAMETERS = {
    "ppo_cnn": 609_970, "lstm_cnn": 1_525_170, "lstm_cnn_published": 1_525_170, "ppo_spcnn": 134_539_730,
    "lstm_spcnn": 135_454_930, "lstm_spcnn_published": 135_454_930, "oc_sa": 3_069_650 + 9_216, "oc_sa_published": 3_069_650,
    "oc_ca": 8_779_730, "oc_ca_published": 8_779_730, "ppo_resnet": 3_948_306, "ppo_resnet_published": 3_948_306,
    "achievement_distillation": 9_234_228, "cnn_distillation": 1_942_228, "grid_distillation": 2_183_732,
}


class Lists(python_case.FolderCase):

  def test_worlds_have_the_published_environments_counts(self):
    lines = re.findall(r"(?m)^(crafter\S*)((?: +[\d.]+ \([\d.]+\)){5})   \S", self.run_program("craftfleet envs").stdout)
    counts = {name: tuple(map(float, re.findall(r" ([\d.]+) \(", text))) for name, text in lines}
    self.assertEqual({name: counts.get(name) for name in COUNTS}, COUNTS)
    self.assertEqual(len(lines), len(counts), "each once")
    mixes = [name for name in counts if name.startswith("crafter:appearance=")]
    self.assertEqual((len(mixes), len(counts)), (8, 15))

  def test_agents_have_their_sizes(self):
    agents = json.loads(self.run_program("craftfleet agents", "--json").stdout)
    self.assertEqual({agent["agent"]: agent["parameters"] for agent in agents}, PARAMETERS)
    for agent in agents:
      self.assertEqual(agent["frame_size"], 72 if agent["agent"].startswith("oc_") else 64, agent)
      self.assertEqual(agent["state_size"], 0 if agent["core"] == "-" else 1024 if agent["extractor"] == "RESNET" else 512, agent)
    text = self.run_program("craftfleet agents").stdout
    for part in (*PARAMETERS, "609,970"):
      self.assertIn(part, text)


python_case.main()
