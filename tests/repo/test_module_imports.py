"""Each module imports by itself, and importing is cheap."""

import json
import os
import subprocess
import sys

import pytest
from repository import MODULES, ROOT

HEAVY = {"kornia", "matplotlib", "mpl_toolkits", "skimage", "tqdm", "trimesh"}
ON_DEMAND = {"fovden.figures": {"matplotlib", "mpl_toolkits"}}  # packages that others import inside functions only

# One process loads what takes long, then forks children that each import one module. Whatever is imported from a
# package begins with the package itself, so a module that the package's own import brings along has been tried with it.
IMPORT_EACH = """
import json, os, sys, traceback
import numba, torch
result = {}
for module in sorted(sys.argv[1:]):
    package = result.get(".".join(module.split(".")[:2]), {})
    if module in package.get("brought", []):
        result[module] = package
        continue
    reader, writer = os.pipe()
    if os.fork() == 0:
        before = set(sys.modules)
        try:
            __import__(module)
            loaded = set(sys.modules) - before
            answer = {"loaded": sorted({name.split(".")[0] for name in loaded}), "brought": sorted(loaded)}
        except BaseException:
            answer = {"error": traceback.format_exc()}
        os.write(writer, json.dumps(answer).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as pipe:
        result[module] = json.loads(pipe.read())
    os.wait()
print(json.dumps(result))
"""

TIME_IMPORT = """
import sys, time, torch
before = set(sys.modules)
start = time.perf_counter()
import fovden
print(time.perf_counter() - start, *sorted({name.split(".")[0] for name in set(sys.modules) - before}))
"""


def python(program: str, *arguments: str) -> str:
    command = [sys.executable, "-W", "error", "-c", program, *arguments]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")
def test_each_module_imports_alone_and_brings_nothing_heavy():
    answers = json.loads(python(IMPORT_EACH, *MODULES))
    assert answers.keys() == MODULES.keys()
    failed = {module: answer["error"] for module, answer in answers.items() if "error" in answer}
    assert not failed, "\n".join(failed.values())
    allowed = {module: ON_DEMAND.get(".".join(module.split(".")[:2]), set()) for module in MODULES}
    heavy = {module: (HEAVY - allowed[module]) & set(answers[module]["loaded"]) for module in MODULES}
    assert {module: found for module, found in heavy.items() if found} == {}


def test_the_package_takes_less_than_a_second_on_top_of_torch():
    for _ in range(3):  # the best of three counts; a busy machine makes any one slow
        seconds, *loaded = python(TIME_IMPORT).split()
        assert not (HEAVY | {"numba", "OpenEXR", "PIL"}) & set(loaded)
        if float(seconds) < 1:
            return
    pytest.fail(f"importing fovden takes {seconds} s")
