import subprocess
import sys

import pytest

from pellucid.citation import PAPERS
from pellucid.cli import options
from pellucid.cli.main import pellucid
from pellucid.model.materials import MATERIALS
from pellucid.version import __version__


def test_help_loads_nothing_heavy():
    # The help must answer at once: what takes long to import is imported by the commands that need it.
    code = (
        "import sys, pellucid\nbefore = set(sys.modules)\nimport pellucid.cli.main\nprint(*set(sys.modules) - before)"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert "pellucid.cli.render" in loaded
    heavy = {"numpy", "scipy", "rich", "matplotlib", "trimesh", "imageio_ffmpeg", "pellucid.scene", "pellucid.gather"}
    assert not heavy & set(loaded)


def test_the_installed_command_answers():
    done = subprocess.run([sys.executable, "-m", "pellucid", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("pellucid 0.")


def test_every_command_explains_itself(run):
    overview = run("--help").output
    for name, command in pellucid.commands.items():
        assert name in overview
        text = run(name, "-h").output
        assert command.help.splitlines()[0] in text
    assert "pellucid render teapot" in overview


def test_the_lists_of_options_match_the_plugins():
    from pellucid.cli import fit as fit_options
    from pellucid.fitting import fit
    from pellucid.methods import METHODS
    from pellucid.methods.surface_samples import SAMPLINGS
    from pellucid.model.medium import PROFILES

    assert set(options.METHODS) == set(METHODS)
    assert options.SAMPLINGS == SAMPLINGS
    assert set(options.PROFILES) == set(PROFILES)
    assert (fit_options.PARAMETERS, fit_options.EXPOSURES) == (fit.PARAMETERS, fit.EXPOSURES)


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (["bogus"], "No such command 'bogus'"),
        (["render"], "Missing argument 'SCENE'"),
        (["render", "ball.xml", "--sppp", "3"], "No such option"),
        (["render", "ball.xml", "--spp", "0"], "0 is not in the range"),
        (["render", "ball.xml", "--samples", "0"], "0 is not in the range"),
        (["render", "ball.xml", "--size", "-3"], "-3.0 is not in the range"),
        (["render", "ball.xml", "--resolution", "640"], "as in 640x480"),
        (["render", "ball.xml", "--resolution", "0x480"], "as in 640x480"),
        (["render", "ball.xml", "--resolution", "1000000x1000000"], "more than"),
        (["render", "ball.xml", "--sigma-a", "1,2"], "three numbers"),
        (["render", "ball.xml", "--sigma-a", "red"], "three numbers"),
        (["render", "ball.xml", "-D", "key"], "-D key=value"),
        (["compare", "ball.xml", "--methods", "two_pass,exac"], "'exac' is no method"),
        (["compare", "ball.xml", "--methods", "exact,exact"], "each method once"),
        (["turntable", "ball.xml", "--frames", "0"], "0 is not in the range"),
    ],
)
def test_a_wrong_call_gets_one_line(run, args, expected):
    result = run(*args, code=2)
    assert expected in result.stderr
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert "--help" in result.stderr


def test_materials_are_listed_with_what_follows_from_them(run):
    lines = run("materials").output.splitlines()
    for name, row in MATERIALS.items():
        assert any(line.strip().startswith(name) for line in lines) == (not row.unscattered)
    assert lines[-1].startswith("Refused, as a channel does not scatter: coke (blue), ")
    marble = next(line for line in lines if "marble" in line)
    # Coefficients, the total of photons (the dipole has 0.83 0.79 0.75), 1/3.007, and the eta that marble alone has.
    assert all(text in marble for text in ("2.19 2.62 3", "0.0021 0.0041 0.0071", "0.84 0.81 0.77", "0.333", "1.5"))


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_profiles_are_plotted(run, tmp_path, suffix):
    run("materials", "--plot", f"profiles{suffix}")
    assert (tmp_path / f"profiles{suffix}").stat().st_size > 10_000


def test_a_plot_without_matplotlib_says_what_to_install(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "'.[plot]'" in run("materials", "--plot", "profiles.png", code=2).stderr
    assert list(tmp_path.iterdir()) == []


def test_the_papers_are_cited(run):
    plain, bibtex = run("cite").output, run("cite", "--bibtex").output
    assert {"JB02", "CLHHC08", "AWB08", "JMLH01"} <= {paper.key for paper in PAPERS}
    assert __version__ in plain and __version__ in bibtex
    for paper in PAPERS:
        assert paper.doi in plain and paper.doi in bibtex
        assert f"{{{paper.key}," in bibtex
    assert bibtex.count("{") == bibtex.count("}")
