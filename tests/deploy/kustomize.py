"""The part of Kustomize that deploy/k8s uses: resources, components, namespace, replicas, config maps from files and literals,
and JSON 6902 patches that replace or remove. Labels and names of images stay as they are, names get no hash, and anything else in a
kustomization is an error.
"""

import copy
import re

import yaml

KNOWN = {"apiVersion", "kind", "namespace", "labels", "resources", "components", "configMapGenerator", "images", "replicas",
         "patches"}


def load_all(path):
  with open(path, encoding="utf-8") as file:
    return [document for document in yaml.safe_load_all(file) if document is not None]


def build(folder, documents=None):
  """The objects of a kustomization; a component changes `documents`. Raises ValueError, KeyError or OSError."""
  settings, = load_all(folder / "kustomization.yaml")
  unknown = set(settings) - KNOWN
  if unknown:
    raise ValueError(f"{folder}: this light Kustomize does not know {sorted(unknown)}")
  documents = [] if documents is None else documents
  for name in settings.get("resources", []):
    documents += build(folder / name) if (folder / name).is_dir() else load_all(folder / name)
  _generate(folder, settings.get("configMapGenerator", []), documents)
  for name in settings.get("components", []):
    build(folder / name, documents)
  for patch in settings.get("patches", []):
    _patch(folder, patch, documents)
  for document in documents:
    if "namespace" in settings and document["kind"] != "Namespace":
      document["metadata"]["namespace"] = settings["namespace"]
    for replicas in settings.get("replicas", []):
      if document["kind"] in ("Deployment", "StatefulSet") and document["metadata"]["name"] == replicas["name"]:
        document["spec"]["replicas"] = replicas["count"]
  return documents


def containers(document):
  if document["kind"] not in ("Deployment", "StatefulSet"):
    return []
  return document["spec"]["template"]["spec"]["containers"]


def _generate(folder, generators, documents):
  for generator in generators:
    data = dict(literal.split("=", 1) for literal in generator.get("literals", []))
    for entry in generator.get("files", []):
      key, _, name = entry.rpartition("=")
      data[key or name] = (folder / name).read_text(encoding="utf-8")
    there = [document for document in documents
             if document["kind"] == "ConfigMap" and document["metadata"]["name"] == generator["name"]]
    if generator.get("behavior") == "merge":
      there[0]["data"].update(data)
    else:
      documents.append({"apiVersion": "v1", "kind": "ConfigMap", "metadata": {"name": generator["name"]}, "data": data})


def _patch(folder, patch, documents):
  target = patch["target"]
  hit = [document for document in documents if document["kind"] == target["kind"] and
         re.fullmatch(target.get("name", ".*"), document["metadata"]["name"])]
  if not hit:
    raise ValueError(f"{folder}: a patch meets no {target}")
  for document in hit:
    for operation in yaml.safe_load(patch["patch"]):
      _apply(operation, document)


def _apply(operation, document):
  *way, last = operation["path"].lstrip("/").split("/")
  for step in way:
    document = document[int(step)] if isinstance(document, list) else document[step]
  if operation["op"] not in ("replace", "remove") or last not in document:
    raise KeyError(f"{operation['op']} {operation['path']}")
  if operation["op"] == "remove":
    del document[last]
  else:
    document[last] = copy.deepcopy(operation["value"])
