"""The report: one file that says everything without script or network, and survives whatever is left out."""

import re
from html.parser import HTMLParser

import numpy as np
import pytest
import view_cases

from cdm_pin import svg
from cdm_pin.errors import InputError
from cdm_pin.manipulator import parse_manipulator
from cdm_pin.model import build_model
from cdm_pin.report import Evidence, LawCurve, report_html, write_report
from cdm_pin.report_figures import error_bars, law, rows, spectrum, state_maps, time_maps
from cdm_pin.report_robot import robot_picture
from cdm_pin.wording import sentence


@pytest.fixture(scope="module")
def model():
    return view_cases.arm()


@pytest.fixture(scope="module")
def evidence(model):
    return view_cases.evidence(model)


@pytest.fixture(scope="module")
def page(model, evidence):
    return report_html(view_cases.diagnosis(), evidence, model)


class Reader(HTMLParser):
    """Checks that tags close in order, and keeps text and addresses."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.addresses, self.tags = [], [], [], set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "xlink:href", "action")]
        if tag not in ("meta", "link", "br", "img"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.add(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] != ["style"]:
            self.text.append(data)


def read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    assert not reader.open
    return reader


def test_first_words_are_the_verdict(page):
    """The verdict's sentence stands before any figure, word for word."""
    text = " ".join(read(page).text).replace("\xa0", " ")
    assert sentence(view_cases.diagnosis()) in text
    assert page.index("Missing physics found") < page.index("<section")


def test_nothing_is_asked_of_the_network_and_nothing_runs(page):
    """No script, no address but anchors and embedded images, and a policy that forbids the rest."""
    reader = read(page)
    assert "script" not in reader.tags and "link" not in reader.tags
    assert all(re.match(r"#|data:image/png", address) for address in reader.addresses)
    assert "default-src 'none'" in page and "url(" not in page and "@import" not in page


def test_all_parts_are_there(page):
    """Where, what, how large, how much better, what would have been seen, what to record next."""
    text = " ".join(read(page).text)
    for words in (
        "dry friction of joint 2, around reversals", "hysteresis of joint 2", "two more numbers, no better fit",
        "0.286 to 0.334", "Izz_2 + m_2*lx^2", "rotor inertia of motor 2", "On unseen recordings", "Simulated motion",
        "Not visible at", "Izz_1", "pretension 80 -> 120 N", "3 repeated samples",
    ):  # fmt: skip
        assert words in text, words


@pytest.mark.parametrize("verdict", ["consistent", "missing_physics", "unexplained", "insufficient_data"])
def test_a_bare_diagnosis_is_a_report_too(model, verdict):
    """Without evidence, fit or findings there is still a page with a sentence."""
    bare = {"verdict": verdict, "findings": [], "rigid_body": {"changed": []}, "sensitivity": []}
    page = report_html(bare, None, model)
    assert sentence(bare) in " ".join(read(page).text)


def test_words_from_outside_are_escaped(model):
    """Names that look like tags are shown, not obeyed."""
    diagnosis = view_cases.diagnosis()
    diagnosis["findings"][0]["region"] = "<script>alert(1)</script>"
    page = report_html(diagnosis, Evidence(notices=("<b>x</b> & y",)), model)
    assert "script" not in read(page).tags and "&lt;b&gt;x" in page


def test_written_whole_or_not_at_all(model, tmp_path):
    """A file appears only whole; a folder that is not there is named."""
    write_report(tmp_path / "report.html", view_cases.diagnosis(), None, model)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(InputError, match="folder of this output file does not exist"):
        write_report(tmp_path / "none" / "report.html", view_cases.diagnosis(), None, model)


def test_same_input_same_bytes(model, evidence, page):
    """A report is reproducible."""
    assert report_html(view_cases.diagnosis(), evidence, model) == page


def test_marks_stand_on_the_places(model):
    """Each kind of location is ringed once, a combination at each of its motors, in the order given."""
    places = [{"kind": "joint", "index": 2}, {"kind": "motor", "index": 1}, {"kind": "link", "index": 3}]
    places += [{"kind": "cable", "index": 2, "link": 1}, {"kind": "base"}, {"kind": "system"}]
    picture = robot_picture(model, [*places, {"kind": "combination", "weights": [1.0, 0.0, -1.0]}])
    assert picture.count('class="mark"') == len(places) + 2
    rings = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="15"[^>]*class="mark"', picture)
    hubs = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="8"', picture)
    assert rings[0] == hubs[1]


def test_numbers_of_one_place_stand_side_by_side(model):
    picture = robot_picture(model, [{"kind": "joint", "index": 2}] * 3)
    across, up = np.array(re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)" r="9"', picture), float).T
    assert np.all(np.diff(across) > 18.0) and np.ptp(up) == 0.0


def test_any_robot_has_a_picture(tmp_path):
    """A robot given by its URDF, without pulleys, is drawn and marked."""
    from cdm_pin.robots import robot_urdf

    model = build_model(parse_manipulator({"name": "ur5", "urdf": str(robot_urdf("ur5_robot"))}))
    picture = robot_picture(model, [{"kind": "joint", "index": 3}, {"kind": "motor", "index": 6}])
    assert picture.count('class="mark"') == 2 and "nan" not in picture


def test_friction_at_a_joint_lights_that_joint_alone(model, evidence):
    """In joint rows a joint's friction shows in its own row; in motor rows in its own and the one before."""
    r = rows(model.joint_from_motor, evidence.noise_floor, "N m")
    assert r.names == ("joint 1", "joint 2", "joint 3", "motor 1", "motor 2", "motor 3")
    run = evidence.runs[0]
    error = (run.measured - run.rigid) @ r.from_motors.T
    assert list(np.sqrt((error**2).mean(0)) > 3) == [False, True, False, True, True, False]
    quiet = (run.measured - run.augmented) @ r.from_motors.T
    np.testing.assert_allclose(np.sqrt((quiet**2).mean(0)), 1.0, atol=0.1)


def test_identity_transmissions_show_joints_once():
    """Where every motor turns its own joint, motors are not listed again."""
    assert rows(np.diag([1.0, 2.0]), None, "N m").names == ("joint 1", "joint 2")


def test_figures_take_gaps_and_long_runs(model):
    """Samples that are not judged stay blank; a million samples make no larger figure than ten thousand."""
    short = view_cases.run(model, "x", holdout=False, seed=3)
    n = 200_000
    tiled = {k: np.resize(getattr(short, k), (n, 3)) for k in ("measured", "rigid", "augmented", "q", "v")}
    valid = np.arange(n) > n // 2
    long = type(short)("x", np.arange(n) / 100.0, **tiled, valid=valid)
    r = rows(model.joint_from_motor, None, "N m")
    pictures = [text for _, text in (*time_maps(long, r), *state_maps([long], r))] + [spectrum(long, 0, 0.02)]
    assert all(0 < len(text) < 60_000 and "nan" not in text for text in pictures)
    curve = LawCurve(tiled["v"][:, 1], "v", tiled["measured"][:, 1], tiled["augmented"][:, 1])
    assert len(law(curve, "law")) < 120_000


def test_nothing_breaks_on_constant_or_missing_data(model):
    """A locked joint, an empty law and a run without state still make figures."""
    zero = np.zeros((50, 3))
    run = type(view_cases.run(model, "x", holdout=False, seed=0))("x", np.arange(50) / 10, zero, zero, zero, zero, zero)
    r = rows(model.joint_from_motor, np.zeros(3), "N m")
    assert time_maps(run, r) and state_maps([run], r) and spectrum(run, 0, None) == ""
    assert law(LawCurve(np.zeros(0), "x", np.zeros(0), np.zeros(0)), "empty")
    assert error_bars([("motor 1", 0.0, 0.0, None)], "N m")


def test_ticks_are_round_and_inside():
    """Ticks lie within the limits at round steps, for any range."""
    for low, high in ((0, 1), (-0.37, 0.42), (1e-6, 3e-6), (950, 1050), (-1e5, 1e5)):
        marks = svg.ticks(low, high)
        assert 2 <= len(marks) <= 12 and all(low - 1e-12 <= m <= high + 1e-9 for m in marks)
        assert len(set(svg.labels(marks))) == len(marks)


def test_a_logarithmic_axis_within_a_decade_has_ticks():
    """Whatever part of a decade, or how many decades, a logarithmic axis shows, it is marked."""
    for low, high in ((2e-4, 8e-4), (0.11, 0.95), (3.0, 70.0), (1e-6, 3e5)):
        marks = svg.ticks(low, high, log=True)
        assert len(marks) >= 2 and all(low <= m <= high for m in marks)
        assert len(set(svg.labels(marks))) == len(marks)


def test_envelope_keeps_the_extremes():
    """Thinning a line for drawing keeps its largest and smallest values."""
    y = np.random.default_rng(0).standard_normal(100_000)
    y[12345], y[54321] = 9.0, -9.0
    x, thin = svg.envelope(np.arange(100_000.0), y, 500)
    assert len(x) <= 1002 and thin.max() == 9.0 and thin.min() == -9.0 and (np.diff(x) >= 0).all()


def test_colours_differ_for_every_kind_of_eye():
    """Lightness of the scales of heat maps rises steadily, so that they read in grey and in any colour vision."""
    rgb = svg.paint(np.linspace(0, 1, 50)[None], (0, 1), svg.SEQUENTIAL)[0].astype(float)
    assert (np.diff(rgb @ [0.2126, 0.7152, 0.0722]) > -0.5).all()


@pytest.mark.parametrize(("other", "advised"), [("load_dependent_friction", True), ("coulomb_friction", False)])
def test_what_reveals_an_effect_is_no_advice_on_where_it_sits(model, evidence, other, advised):
    diagnosis = view_cases.diagnosis()
    place = {"kind": "joint", "index": 2} if advised else {"kind": "motor", "index": 2}
    diagnosis["findings"][0]["indistinguishable_from"] = [{"effect": other, "location": place}]
    assert ("To tell" in report_html(diagnosis, evidence, model)) == advised
