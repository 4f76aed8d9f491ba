"""The package holds to its own rules: imports only downward, nothing printed, public names documented."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parent.parent / "cdm_pin"
MODULES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in sorted(PACKAGE.rglob("*.py"))}
every_module = pytest.mark.parametrize("name", MODULES)

TOP = {"cli", "commands"}  # imported by nothing below


def imports(name):
    """Modules of the package that `name` imports, at its top or inside functions, but not for type hints alone."""
    tree = ast.parse(MODULES[name].read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    package = name.split(".")[:-1]
    found = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.ImportFrom) or (node.level == 0 and not (node.module or "").startswith("cdm_pin")):
            continue
        base = package[: len(package) - node.level + 1] if node.level else []
        target = [*base, *(node.module or "").removeprefix("cdm_pin").strip(".").split(".")]
        target = ".".join(part for part in target if part)
        for alias in node.names:
            inner = f"{target}.{alias.name}".strip(".")
            found.add(inner if inner in MODULES else target)
    return {module for module in found if module in MODULES} - {name}


def test_imports_form_layers():
    """No module imports, at its top or inside a function, one that imports it in turn: there is an order."""
    graph = {name: imports(name) for name in MODULES if not name.endswith("__init__")}
    try:
        order = list(TopologicalSorter(graph).static_order())
    except CycleError as exc:
        pytest.fail(f"imports in a circle: {' -> '.join(exc.args[1])}")
    assert order.index("errors") < order.index("geometry") < order.index("manipulator") < order.index("model")
    assert order.index("model") < order.index("dynamics") < order.index("cables")


@every_module
def test_only_commands_know_the_command_line(name):
    """Library modules import neither cli nor commands."""
    if name.split(".")[0] not in TOP:
        assert not {m for m in imports(name) if m.split(".")[0] in TOP}


@every_module
def test_independent_simulators_share_nothing_with_the_judge(name):
    """plant/* imports nothing of effects, identification, diagnosis or regressors."""
    if name.startswith("plant."):
        assert not imports(name) & {"effects", "identify", "diagnose", "regressor", "motion", "dynamics", "kernels"}


@every_module
def test_library_code_prints_nothing(name):
    """Only the command line and its console print."""
    if name.split(".")[0] in TOP or name == "console":
        return
    calls = [node for node in ast.walk(ast.parse(MODULES[name].read_text())) if isinstance(node, ast.Call)]
    assert not [node for node in calls if isinstance(node.func, ast.Name) and node.func.id == "print"]


@every_module
def test_public_names_are_documented(name):
    """Every module, public class and public function has a docstring."""
    tree = ast.parse(MODULES[name].read_text())
    assert ast.get_docstring(tree) or not tree.body
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{name}.{node.name}"
