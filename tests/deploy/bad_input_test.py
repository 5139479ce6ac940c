"""Real programs with wrong flags, configuration files and textures: errors name the place and what was expected."""

import json
import os
import shutil
import subprocess

from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE, built

# By program: flags, and texts of the one line on standard error. "@" is the test's folder, which has config.txt.
REFUSED = {
    "craftfleet train": [
        ("--logdir=@/run --lnes=3", "'lnes' (did you mean --lanes?)", "--help"),
        ("--logdir=@/run --qqqqq", "unknown flag 'qqqqq'; see"),
        ("--logdir=@/run --noresum", "'noresum' (did you mean --resume?)"),
        ("--logdir=@/run lanes=3", '"lanes=3" is not a flag (did you mean --lanes=3?)', "--help"),
        ("--logdir=@/run --lanes=abc", "craftfleet train: --lanes=abc, want a whole number; see"),
        ("--logdir=@/run --lanes abc", "craftfleet train: --lanes=abc, want a whole number; see"),
        ("--logdir=@/run --seed=-1", "--seed=-1, want a whole number, at least 0;"),
        ("--logdir=@/run --seed=", "--seed=, want a whole number, at least 0;"),
        ("--logdir=@/run --steps=", "--steps=, want a whole number, such as"),
        ("--logdir=@/run --agent=", "--agent=, want a value, or omit the flag;"),
        ("--logdir=@/run --noresume=true", "craftfleet train: --noresume=true: --noresume takes no value; see"),
        ("--logdir=@/run --flagfile=@/config.txt", "unknown flag 'flagfile'"),
        ("--logdir=@/run --undefok=lanes", "unknown flag 'undefok'"),
        ("--logdir=@/run --env_timeout=0", "craftfleet train: --env_timeout=0, want 100ms..1h"),
        ("--logdir=@/run --env_timeout=2h", "--env_timeout=2h, want 100ms..1h"),
        ("--logdir=@/run --resume=maybe", "--resume=maybe, want true or false;"),
        ("--logdir", "craftfleet train: --logdir needs a value: --logdir=VALUE;"),
        ("--logdir=@/run --lanes=7", "ppo.rollout_steps", "lanes (7)"),
        ("--logdir=@/run --device=cuda:99", "--device=cuda:99: "),
        ("--logdir=@/run --env=pong", 'unknown game "pong", want "crafter"'),
        ("", "--logdir is missing"),
        ("--logdir=/proc/no/such", "/proc/no"),
        ("--logdir=@/run --threads=999", "--threads=999, want 0..256"),
        ("--logdir=@/run --config=@/none.txt", "--config: ", "/none.txt", "No such file"),
        ("--logdir=@/run --resume", "--resume: no run in --logdir=", "/run", "start it without --resume"),
        ("--logdir=@/run --resume --config=@/config.txt", "--resume: no run in --logdir=", "/run", "start it without --resume"),
        ("--logdir=@/run --max_staleness=1 --overlap=1", "overlap and max_staleness are both given"),
        ("--logdir=@/run --resume_from=x", "--resume_from requires --resume"),
        ("--logdir=@/run --textures=@/none", "/none", "No such file"),
        ("--logdir=@/run --listen=http://a:1", '--listen: "http://a:1" is not an address, want ', "without http://"),
    ],
    "craftfleet status": [
        ("--interval=5sec", "--interval=5sec, want a length of time", "a number without a unit is in seconds"),
        ("--interval=500", "--interval=8m20s"),
        ("--address=x", '--address: "x" is not an address'),
        ("--address=127.0.0.1:1", "127.0.0.1:1: cannot connect: nothing listens there"),
        ("127.0.0.1:1", '"127.0.0.1:1" is not a flag', "--help"),
    ],
    "craftfleet-learner": [
        ("--logdir=@/run --listen=0.0.0.0:0", "--listen=0.0.0.0:0 reaches beyond this host", "--insecure"),
        ("--logdir=@/run --world_size=2 --rank=2", "--rank=2, want 0..1"),
        ("--logdir=@/run --rank=1", "--rank=1, want 0..0"),
        ("--logdir=@/run --world_size=0", "--world_size=0, want 1..256"),
        ("--world_size=2 --rank=1 --master_port=0", "--master_port=0, want 1..65535"),
        ("--world_size=2 --rank=1 --rank_timeout=0", "--rank_timeout=0, want 1s..24h"),
        ("--world_size=2 --rank=1 --device=cuda", "--device=cuda", "CPUs"),
        ("--logdir=@/run --listen=http://a:1", '--listen: "http://a:1" is not an address, want ', "without http://"),
    ],
    "craftfleet-envserver": [
        ("--textures=@/none", "/none", "No such file"),
        ("--listen=0.0.0.0:0", "--listen=0.0.0.0:0", "--insecure"),
        ("--listen=127.0.0.1", '--listen: "127.0.0.1" is not an address, want HOST:PORT'),
        ("--listen=", '--listen: "" is not an address, want HOST:PORT'),
        ("--max_games=99999999999", "--max_games=99999999999, want a smaller number;"),
        ("--listen=0.0.0.0:0 --insecure --learner=127.0.0.1:1", "--listen=0.0.0.0:0 is every address", "--advertise=HOST:PORT"),
        ("--advertise=[::]:1 --learner=127.0.0.1:1", "--advertise=[::]:1 is every address of this host"),
        ("--advertise=[::0]:1 --learner=127.0.0.1:1", "--advertise=[::0]:1 is every address of this host"),
        ("--advertise=0:1 --learner=127.0.0.1:1", "--advertise=0:1 is every address of this host"),
        ("--metrics_listen=http://a:1", '--metrics_listen: "http://a:1" is not an address, want ', "without http://"),
    ],
    "craftfleet-actor": [
        ("--learner=here", '--learner: "here" is not an address'),
        ("--envservers=127.0.0.1:1,x", '--envservers: "x" is not an address'),
        ("--envservers=", "--envservers is empty"),
        ("--frames=png", "--frames=png, want raw or scene"),
        ("--threads=-1", "--threads=-1, want 0..256; 0: as many as the CPU quota allows"),
        ("--max_lanes=0", "--max_lanes=0, want 1..4096"),
        ("--env_timeout=0", "--env_timeout=0, want 0.1..3600 s"),
    ],
    "craftfleet eval": [
        ("--json=a.json", "unknown flag 'json' (did you mean --out?)"),
        ("", "--checkpoint is missing"),
        ("--checkpoint=@", "no checkpoint at /", "want a run's folder"),
        ("--checkpoint=@ --episodes=0", "--episodes=0", "want 1..10000"),
        ("--checkpoint=@ --env=pong", "craftfleet eval: --env: ", 'unknown game "pong", want "crafter"'),
    ],
    "craftfleet": [
        ("--nope", 'unknown flag "--nope"; see craftfleet --help'),
        ("help --nope", 'unknown flag "--nope"; see craftfleet --help'),
        ("runs/first", 'there is no command "runs/first"; see'),
        ("nope", 'there is no command "nope"', "--help"),
        ("trian", 'there is no command "trian" (did you mean "train"?)', "--help"),
        ("help evla", 'there is no command "evla" (did you mean "eval"?)'),
    ],
    "craftfleet envs": [
        ("--address=127.0.0.1:1", "unknown flag 'address'; see"),
        ("--worlds=0", "--worlds=0, want 1..100000"),
    ],
    "craftfleet doctor": [
        ("--listen=here", '--listen: "here" is not an address, want HOST:PORT'),
        ("--tls_server_name=t", "unknown flag 'tls_server_name'"),
    ],
    "craftfleet watch": [
        ("run --video=a.mp4 --follow", "--follow and --video: want one of them"),
        ("run --strip=a.png --terminal", "--terminal and --strip"),
    ],
    "craftfleet report": [
        ("@ --out=@/report", "no run in or below ", "want a folder with config.txt and stats.jsonl"),
    ],
    "craftfleet curve": [
        ("@/none", "/none: no such run folder or file"),
    ],
    "craftfleet admin": [
        ("", "name a command: checkpoint, pause, resume, drain NAME"),
        ("drian a", '"drian" is not a command (did you mean "drain"?)'),
        ("pause --address=http://a:1", '--address: "http://a:1" is not an address, want ', "without http://"),
    ],
    "craftfleet top": [
        ("--address=127.0.0.1:1", "127.0.0.1:1: cannot connect: nothing listens there"),
        ("--address=http://a:1", '--address: "http://a:1" is not an address, want ', "without http://"),
    ],
}
IN_PYTHON = ["craftfleet curve", "craftfleet top"]
PROGRAMS = ["craftfleet", "craftfleet train", "craftfleet eval", "craftfleet status", "craftfleet-learner", "craftfleet-actor",
            "craftfleet-envserver", *IN_PYTHON]


class BadInput(python_case.FolderCase):

  def setUp(self):
    super().setUp()
    self.config = self.folder / "config.txt"
    self.config.write_text(python_case.SMALL_RUN)

  def test_a_wrong_command_line_is_refused_with_one_line_that_names_the_error(self):
    for program, rows in REFUSED.items():
      for arguments, *errors in rows:
        with self.subTest(program, arguments=arguments):
          ended = self.run_program(program, *arguments.replace("@", str(self.folder)).split(), code=1)
          for error in errors:
            self.assertIn(error, ended.stderr)
          self.assertEqual(len(ended.stderr.splitlines()), 1, ended.stderr)
          self.assertEqual(ended.stdout, "")
          self.assertFalse((self.folder / "run").exists(), "no run was started")

  def test_a_url_is_refused_also_by_what_has_begun_to_listen(self):
    for program, flag in (("craftfleet-envserver", "learner"), ("craftfleet train", "http_listen")):
      more = [f"--logdir={self.folder}/run"] if program == "craftfleet train" else ["--listen=127.0.0.1:0"]
      refused = self.run_program(program, f"--{flag}=http://a:1", *more, code=1)
      self.assertIn(f'--{flag}: "http://a:1" is not an address, want HOST:PORT or unix:PATH, without http://', refused.stderr)
    self.assertFalse((self.folder / "run/config.txt").exists())

  def test_errors_in_a_configuration_file_have_file_line_and_field(self):
    for text, errors in (("lanes: 4\nppo {\n  rollout_stps: 64\n}\n", (":3:", '"rollout_stps"', "known fields of PpoConfig: rollout_steps, ")),
                         ("lanes: 4\nsteps: many\n", (":2:", "steps: "))):
      self.config.write_text(text)
      refused = self.run_program("craftfleet train", f"--config={self.config}", f"--logdir={self.folder}/run", code=1)
      self.assertIn(f"{self.config}{errors[0]}", refused.stderr)
      for error in errors[1:]:
        self.assertIn(error, refused.stderr)
    self.assertFalse((self.folder / "run").exists())

  def test_standard_input_that_cannot_be_read_is_not_its_end(self):
    run = python_case.trained_run(self.folder / "run", python_case.SMALL_RUN)
    for program in (["craftfleet inspect"], ["craftfleet policy", f"--checkpoint={run}"]):
      folder = os.open("/", os.O_RDONLY)
      self.addCleanup(os.close, folder)
      ended = subprocess.run([*built(program[0]), *program[1:]], stdin=folder, capture_output=True, text=True, timeout=60, check=False)
      self.assertEqual((ended.returncode, ended.stderr), (1, f"{program[0]}: cannot read standard input: Is a directory\n"))

  def test_a_missing_or_invalid_texture_is_named(self):
    textures = self.folder / "textures"
    shutil.copytree(SOURCE / "envserver/textures", textures)
    for write in ((textures / "stone.png").unlink, lambda: (textures / "stone.png").write_text("no picture")):
      write()
      refused = self.run_program("craftfleet-envserver", f"--textures={textures}", code=1)
      self.assertIn(f"{textures}/stone.png", refused.stderr)

  def test_a_command_without_its_program_is_not_called_unknown(self):
    alone = self.folder / "craftfleet"  # its programs were not copied with it
    shutil.copy(BIN / "craftfleet", alone)
    self.assertIn(f"cannot run {alone}-torch: No such file", self.run_program(str(alone), "train", code=1).stderr)

  def test_every_program_explains_itself(self):
    for program in PROGRAMS:
      with self.subTest(program):
        for flag in ("--help", "--helpfull", "--help_json", "--version"):
          if flag == "--help_json" and program in IN_PYTHON:
            continue  # no other program asks those
          ended = self.run_program(program, flag)
          self.assertEqual(ended.stderr, "")
          if flag == "--help":
            self.assertIn(program.split("-")[0], ended.stdout)
          elif flag == "--helpfull" and program not in ("craftfleet", *IN_PYTHON):  # which have no log
            self.assertIn("  --log_level (default info)\n", ended.stdout)
          elif flag == "--help_json":
            self.assertEqual(json.loads(ended.stdout)["program"], program)
          elif flag == "--version":
            self.assertRegex(ended.stdout, r"^\S.* \d+\.\d+\.\d+ \(.*\)\n$")
        if not any("unknown flag" in error for _, *errors in REFUSED.get(program, []) for error in errors):
          self.assertIn("no_such_flag", self.run_program(program, "--no_such_flag=1", code=1).stderr)

  def test_help_for_a_command_is_that_of_its_program_and_fits_a_screen(self):
    text = self.run_program("craftfleet", "help", "train").stdout
    self.assertTrue(text.startswith("craftfleet train trains an agent"))
    self.assertIn("--logdir", text)
    self.assertEqual(text, self.run_program("craftfleet train", "--help").stdout)
    self.assertLessEqual(text.count("\n"), 40)


python_case.main()
