"""deploy/k8s: every manifest parses, and every reference resolves: names, selectors, ports, probes, flags, keys.

The checks run over what a light Kustomize of our own builds from each overlay.
"""

import json
import os
import re
import shutil
import subprocess
import tempfile
import unittest
import urllib.request

from tests.deploy.flags import split, unknown_flags
from tests.fakes import python_case
from tests.fakes.python_case import BIN, SOURCE, built, wait_until

try:
  import yaml
  from tests.deploy import kustomize
except ImportError:
  yaml = None

K8S = SOURCE / "deploy/k8s"
OVERLAYS = ("one-machine", "cpu-cluster")
# API versions that Kubernetes serves since 1.27 and has not deprecated.
KINDS = {"Namespace": "v1", "Service": "v1", "ConfigMap": "v1", "Deployment": "apps/v1", "StatefulSet": "apps/v1",
         "HorizontalPodAutoscaler": "autoscaling/v2", "PodDisruptionBudget": "policy/v1",
         "NetworkPolicy": "networking.k8s.io/v1"}
WORKLOADS = ("Deployment", "StatefulSet")


def fits(selector, labels):
  return all(labels.get(key) == value for key, value in selector.items())


class Objects:
  """The objects of an overlay."""

  def __init__(self, documents):
    self.all = documents

  def of(self, *kinds):
    return [document for document in self.all if document["kind"] in kinds]

  def workloads(self, selector):
    return [document for document in self.of(*WORKLOADS) if fits(selector, document["spec"]["template"]["metadata"]["labels"])]

  def ports(self, selector):
    """Names and numbers of the ports of the pods that match the selector."""
    return {key for workload in self.workloads(selector) for container in kustomize.containers(workload)
            for port in container["ports"] for key in (port["name"], port["containerPort"])}


class Manifests(unittest.TestCase):

  def setUp(self):
    if yaml is None:
      self.skipTest("no python3-yaml here: deploy/install-deps.sh --tests")

  def over_all(self, check):
    for overlay in OVERLAYS:
      with self.subTest(overlay=overlay):
        check(Objects(kustomize.build(K8S / "overlays" / overlay)))

  # The files.

  def test_kinds_are_known_and_current_and_names_are_unique(self):
    def check(objects):
      for document in objects.all:
        self.assertEqual(document["apiVersion"], KINDS[document["kind"]], document["metadata"]["name"])
        self.assertRegex(document["metadata"]["name"], r"^[a-z0-9]([-a-z0-9]{0,61}[a-z0-9])?$")
        if document["kind"] != "Namespace":
          self.assertEqual(document["metadata"]["namespace"], "craftfleet")
      names = [(document["kind"], document["metadata"]["name"]) for document in objects.all]
      self.assertEqual(len(names), len(set(names)), names)
      namespace, = objects.of("Namespace")  # Kubernetes refuses pods in it with more privileges than they need
      self.assertEqual(namespace["metadata"]["labels"]["pod-security.kubernetes.io/enforce"], "restricted")
    self.over_all(check)

  # References.

  def test_selectors_find_their_pods(self):
    def check(objects):
      for workload in objects.of(*WORKLOADS):
        self.assertEqual(objects.workloads(workload["spec"]["selector"]["matchLabels"]), [workload])
      for document in objects.of("Service"):
        self.assertEqual(len(objects.workloads(document["spec"]["selector"])), 1, document["metadata"]["name"])
      for document in objects.of("PodDisruptionBudget"):
        self.assertEqual(len(objects.workloads(document["spec"]["selector"]["matchLabels"])), 1, document["metadata"]["name"])
      budgets = {document["metadata"]["name"] for document in objects.of("PodDisruptionBudget")}
      self.assertEqual(budgets, {workload["metadata"]["name"] for workload in objects.of(*WORKLOADS)})
      for document in objects.of("HorizontalPodAutoscaler"):
        target = document["spec"]["scaleTargetRef"]
        found = [workload for workload in objects.of(target["kind"]) if workload["metadata"]["name"] == target["name"]]
        self.assertEqual(len(found), 1, target)
        self.assertNotIn("replicas", found[0]["spec"], "the autoscaler's to say")
        self.assertEqual(target["apiVersion"], found[0]["apiVersion"])
      for workload in objects.of("Deployment"):
        constraint, = workload["spec"]["template"]["spec"]["topologySpreadConstraints"]
        self.assertEqual(objects.workloads(constraint["labelSelector"]["matchLabels"]), [workload])
    self.over_all(check)

  def test_services_and_policies_name_ports_that_their_pods_have(self):
    def check(objects):
      for document in objects.of("Service"):
        for port in document["spec"]["ports"]:
          self.assertIn(port["targetPort"], objects.ports(document["spec"]["selector"]))
      for document in objects.of("NetworkPolicy"):
        own = document["spec"]["podSelector"].get("matchLabels", {})
        self.assertTrue(objects.workloads(own), document["metadata"]["name"])
        for direction, peers, side in (("ingress", "from", own), ("egress", "to", None)):
          for rule in document["spec"].get(direction, []):
            for peer in rule[peers]:
              if "podSelector" in peer:
                labels = peer["podSelector"]["matchLabels"]
                self.assertTrue(objects.workloads(labels), f"{document['metadata']['name']}: {peer}")
                for port in rule.get("ports", []):
                  self.assertIn(port["port"], objects.ports(labels if side is None else side))
    self.over_all(check)

  def test_addresses_in_flags_are_services_and_the_policies_let_them_through(self):
    def check(objects):
      for workload in objects.of(*WORKLOADS):
        for argument in kustomize.containers(workload)[0]["args"]:
          name, value = split(argument)
          if name not in ("learner", "envservers"):
            continue
          host, port = value.removeprefix("dns:").split(":")
          service, = [document for document in objects.of("Service") if document["metadata"]["name"] == host]
          self.assertIn(int(port), [entry["port"] for entry in service["spec"]["ports"]])
          if value.startswith("dns:"):
            self.assertEqual(service["spec"]["clusterIP"], "None", "every pod's address is wanted")
          labels = workload["spec"]["template"]["metadata"]["labels"]
          policies = [document["spec"] for document in objects.of("NetworkPolicy")
                      if document["spec"]["podSelector"].get("matchLabels") == service["spec"]["selector"]]
          allowed = [peer["podSelector"]["matchLabels"] for policy in policies for rule in policy["ingress"] for peer in rule["from"]]
          self.assertTrue(any(fits(peer, labels) for peer in allowed))
      stateful, = objects.of("StatefulSet")
      service, = [document for document in objects.of("Service") if document["metadata"]["name"] == stateful["spec"]["serviceName"]]
      self.assertEqual(service["spec"]["clusterIP"], "None")
    self.over_all(check)

  def secrets(self):
    """The secrets that each of the two ways creates: name -> keys."""
    with tempfile.TemporaryDirectory(prefix="craftfleet-") as folder:
      ended = subprocess.run([K8S / "tls-secrets.sh", f"{folder}/certs"], capture_output=True, text=True, check=True)
    made = {document["metadata"]["name"]: set(document["data"]) for document in yaml.safe_load_all(ended.stdout) if document}
    certificates = [document for document in kustomize.build(K8S / "cert-manager") if document["kind"] == "Certificate"]
    issued = {document["spec"]["secretName"]: {"tls.crt", "tls.key", "ca.crt"} for document in certificates}
    return made, issued

  def test_volumes_and_the_files_in_them_are_there(self):
    secret_sets = self.secrets()
    def check(objects):
      maps = {document["metadata"]["name"]: set(document["data"]) for document in objects.of("ConfigMap")}
      for workload in objects.of(*WORKLOADS):
        pod = workload["spec"]["template"]["spec"]
        container, = pod["containers"]
        claims = {claim["metadata"]["name"] for claim in workload["spec"].get("volumeClaimTemplates", [])}
        sources = {volume["name"]: volume for volume in pod.get("volumes", [])}
        self.assertEqual(claims | sources.keys(), {mount["name"] for mount in container["volumeMounts"]})
        for entry in container.get("env", []):
          reference = entry.get("valueFrom", {}).get("configMapKeyRef")
          if reference is None:  # a value, or a field of the pod
            self.assertTrue("value" in entry or "fieldRef" in entry["valueFrom"], entry)
          else:
            self.assertIn(reference["key"], maps[reference["name"]])
        for secrets in secret_sets:
          files = {}
          for mount in container["volumeMounts"]:
            source = sources.get(mount["name"], {})
            keys = maps[source["configMap"]["name"]] if "configMap" in source else ()
            keys = secrets[source["secret"]["secretName"]] if "secret" in source else keys
            files.update({f"{mount['mountPath']}/{key}": mount for key in keys})
          for argument in container["args"]:
            value = split(argument)[1]
            if value.startswith("/etc/"):
              self.assertIn(value, files, argument)
        for variable in re.findall(r"\$\((\w+)\)", " ".join(container["args"])):
          self.assertIn(variable, [entry["name"] for entry in container.get("env", [])])
    self.over_all(check)

  def test_certificates_carry_the_names_that_clients_ask_for(self):
    certificates = {document["metadata"]["name"]: document["spec"] for document in kustomize.build(K8S / "cert-manager")
                    if document["kind"] == "Certificate"}
    issuers = {document["metadata"]["name"] for document in kustomize.build(K8S / "cert-manager") if document["kind"] == "Issuer"}
    for spec in certificates.values():
      self.assertIn(spec["issuerRef"]["name"], issuers)
    self.assertIn("127.0.0.1", certificates["craftfleet-learner"]["ipAddresses"], "of kubectl port-forward")
    def check(objects):
      for service in objects.of("Service"):
        name = service["metadata"]["name"]
        self.assertIn(name, certificates[name]["dnsNames"])
        workload, = objects.workloads(service["spec"]["selector"])
        secrets = [volume["secret"]["secretName"] for volume in workload["spec"]["template"]["spec"]["volumes"] if "secret" in volume]
        self.assertEqual(secrets, [certificates[name]["secretName"]])
      access, = [document["data"]["access.txt"] for document in objects.of("ConfigMap")
                 if document["metadata"]["name"] == "craftfleet-access"]
      for name in re.findall(r'certificate: "([^"]*)"', access):
        self.assertIn(name, [spec["commonName"] for spec in certificates.values()])
    self.over_all(check)

  def test_the_cluster_overlay_is_autoscaled_by_a_metric_that_the_adapter_exposes(self):
    rules, = kustomize.load_all(K8S / "autoscale/prometheus-adapter-values.yaml")
    autoscalers = Objects(kustomize.build(K8S / "overlays/cpu-cluster")).of("HorizontalPodAutoscaler")
    self.assertEqual(len(autoscalers), 2)
    for document in autoscalers:
      names = [metric["external"]["metric"]["name"] for metric in document["spec"]["metrics"]]
      self.assertEqual(names, [rule["name"]["matches"] for rule in rules["rules"]["external"]])

  # The containers.

  def test_flags_are_those_of_the_programs(self):
    def check(objects):
      for workload in objects.of(*WORKLOADS):
        container, = kustomize.containers(workload)
        program, = container["command"]
        self.assertEqual(unknown_flags(program, container["args"]), [], program)
    self.over_all(check)

  def test_probes_and_ports_are_those_that_the_process_listens_on(self):
    def check(objects):
      for workload in objects.of(*WORKLOADS):
        container, = kustomize.containers(workload)
        listens = dict(split(argument) for argument in container["args"])
        ports = {port["name"]: port["containerPort"] for port in container["ports"]}
        self.assertEqual(listens["listen"], f"[::]:{ports['grpc']}")
        self.assertEqual(listens["metrics_listen"], f"[::]:{ports['metrics']}")
        self.assertEqual(len(set(ports.values())), 2)
        self.assertEqual(workload["spec"]["template"]["metadata"]["annotations"]["prometheus.io/port"], str(ports["metrics"]))
        # Kubernetes' gRPC probes do not support TLS.
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
          self.assertEqual(container[probe]["httpGet"], {"path": "/healthz", "port": "metrics"})
        self.assertNotIn("insecure", listens)
        self.assertTrue({"tls_cert", "tls_key", "tls_ca", "access_file"} <= listens.keys())
    self.over_all(check)

  def test_pods_have_room_and_time_for_their_process(self):
    def check(objects):
      for workload in objects.of(*WORKLOADS):
        pod = workload["spec"]["template"]["spec"]
        container, = pod["containers"]
        self.assertTrue(pod["shareProcessNamespace"], "or a SIGTERM is lost while it starts")
        self.assertGreaterEqual(pod["terminationGracePeriodSeconds"], 15, "a process has 10 s to stop")
        flags = dict(split(argument) for argument in container["args"])
        if container["command"] == ["craftfleet-envserver"]:
          budget = int(flags.get("max_games_mb", 2048)) + int(flags.get("max_buffered_mb", 512))
          gigabytes = re.fullmatch(r"(\d+)Gi", container["resources"]["limits"]["memory"])[1]
          self.assertGreater(int(gigabytes) * 1024, budget)
      stateful, = objects.of("StatefulSet")
      container, = kustomize.containers(stateful)
      run, = [document["data"]["config.txt"] for document in objects.of("ConfigMap") if "config.txt" in document["data"]]
      shards = re.search(r"^gradient_shards: (\d+)", run, re.MULTILINE)
      self.assertLessEqual(int(container["resources"]["limits"]["cpu"]), int(shards[1]) if shards else 2, "or cores are idle")
      ranks = {entry["name"]: entry.get("value") for entry in container["env"]}.get("WORLD_SIZE", 1)
      self.assertEqual(stateful["spec"]["replicas"], int(ranks), "one pod for each rank")
      claim, = stateful["spec"]["volumeClaimTemplates"]
      mount, = [mount["mountPath"] for mount in container["volumeMounts"] if mount["name"] == claim["metadata"]["name"]]
      self.assertTrue(dict(split(argument) for argument in container["args"])["logdir"].startswith(mount + "/"))
    self.over_all(check)


class Fleet(python_case.FolderCase):
  """Runs the programs on this machine with the flags, configurations and access rules of the manifests."""

  def setUp(self):
    if yaml is None:
      self.skipTest("no python3-yaml here: deploy/install-deps.sh --tests")
    super().setUp()
    certs = self.folder / "certs"
    subprocess.run([K8S / "tls-secrets.sh", certs], check=True, capture_output=True)
    for name in ("learner", "actor", "envserver", "ops"):
      tls = self.folder / name / "tls"
      tls.mkdir(parents=True)
      for key, source in (("tls.crt", f"craftfleet-{name}.pem"), ("tls.key", f"craftfleet-{name}.key"), ("ca.crt", "ca.pem")):
        (tls / key).write_bytes((certs / source).read_bytes())

  def start(self, objects, name, addresses, more=()):
    """Starts a workload's container with its files below self.folder/NAME and free ports."""
    for document in objects.of("ConfigMap"):
      part = {"craftfleet-run": "run", "craftfleet-access": "access"}[document["metadata"]["name"]]
      (self.folder / name / part).mkdir(exist_ok=True)
      for key, text in document["data"].items():
        (self.folder / name / part / key).write_text(text)
    container, = [container for workload in objects.of(*WORKLOADS) for container in kustomize.containers(workload)
                  if container["name"] == name]
    arguments = []
    for argument in container["args"]:
      argument = argument.replace("/etc/craftfleet", f"{self.folder}/{name}").replace("/runs/$(CRAFTFLEET_RUN)", f"{self.folder}/run")
      argument = re.sub(r"=\[::\]:\d+$", "=127.0.0.1:0", argument)
      for service, address in addresses.items():
        argument = re.sub(rf"=(dns:)?{service}:\d+$", f"={address}", argument)
      arguments.append(argument)
    self.log = self.folder / f"{name}.log"
    with open(self.log, "wb") as log:
      process = subprocess.Popen([BIN / container["command"][0], *arguments, *more], stdout=log, stderr=log,
                                 env={"PATH": os.environ["PATH"]}, cwd="/")
    self.addCleanup(process.wait)
    self.addCleanup(process.kill)
    log = self.log

    def address():
      self.assertIsNone(process.poll(), log.read_text())
      found = re.search(r'"message":"[^"]*(?:listening|status) on ([^ ,"]+)', log.read_text())
      return found and found[1]
    return process, wait_until(address, f"the address of {name}")

  def test_the_fleet_of_the_manifests_trains(self):
    objects = Objects(kustomize.build(K8S / "overlays/one-machine"))
    for document in objects.of("ConfigMap"):
      if "config.txt" in document["data"]:
        document["data"]["config.txt"] = python_case.SMALL_RUN
    learner, learner_address = self.start(objects, "learner", {}, ["--threads=1"])
    envserver, envserver_address = self.start(objects, "envserver", {})
    actor, _ = self.start(objects, "actor", {"craftfleet-learner": learner_address, "craftfleet-envserver": envserver_address})
    self.assertEqual(learner.wait(timeout=120), 0, (self.folder / "learner.log").read_text())
    self.assertIn("the run is complete", (self.folder / "learner.log").read_text())
    self.assertEqual(actor.wait(timeout=20), 0, (self.folder / "actor.log").read_text())
    envserver.terminate()
    self.assertEqual(envserver.wait(timeout=20), 0)

  def test_operators_may_watch_and_others_may_not(self):
    objects = Objects(kustomize.build(K8S / "overlays/one-machine"))
    learner, address = self.start(objects, "learner", {}, ["--threads=1"])
    for name, code in (("ops", 0), ("envserver", 1)):
      tls = self.folder / name / "tls"
      ended = subprocess.run([*built("craftfleet status"), f"--address={address}", f"--tls_ca={tls}/ca.crt", f"--tls_cert={tls}/tls.crt",
                              f"--tls_key={tls}/tls.key"], capture_output=True, text=True, check=False)
      self.assertEqual(ended.returncode, code, ended.stdout + ended.stderr)
    learner.terminate()
    self.assertEqual(learner.wait(timeout=20), 0)

  def test_the_learner_serves_the_metric_that_scales(self):
    objects = Objects(kustomize.build(K8S / "overlays/cpu-cluster"))
    learner, _ = self.start(objects, "learner", {}, ["--threads=1"])
    address = wait_until(lambda: re.search(r"metrics on (http://[^ \"]+)", self.log.read_text()), "the address of metrics")[1]

    def served(name, labels):
      with urllib.request.urlopen(address, timeout=10) as reply:
        lines = reply.read().decode().splitlines()
      return any(line.startswith(name + "{") and all(f'{key}="{value}"' in line for key, value in labels.items()) for line in lines)

    for document in objects.of("HorizontalPodAutoscaler"):
      for metric in document["spec"]["metrics"]:
        wanted = metric["external"]["metric"]
        wait_until(lambda wanted=wanted: served(wanted["name"], wanted["selector"]["matchLabels"]), f"{wanted}", seconds=20)
    learner.terminate()
    self.assertEqual(learner.wait(timeout=20), 0)

  def test_every_overlay_has_a_configuration_that_the_learner_accepts(self):
    for overlay in OVERLAYS:
      objects = Objects(kustomize.build(K8S / "overlays" / overlay))
      learner, _ = self.start(objects, "learner", {}, ["--threads=1", "--device=cpu"])
      learner.terminate()
      self.assertEqual(learner.wait(timeout=20), 0, self.log.read_text())
      shutil.rmtree(self.folder / "run")


python_case.main()
