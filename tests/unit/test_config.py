"""Settings files: the smallest ones, and what is said of wrong ones."""

import json

import pytest
from pydantic import TypeAdapter, ValidationError

from cloudtomo_cl.errors import DataError, SettingsError
from cloudtomo_cl.files.phase import write_phase_function
from cloudtomo_cl.inversion.priors import Prior
from cloudtomo_cl.inversion.solvers.choice import SolverTable
from cloudtomo_cl.inversion.solvers.descent import SGD, Adam
from cloudtomo_cl.inversion.solvers.gauss_newton import GaussNewton
from cloudtomo_cl.inversion.stages import Stage
from cloudtomo_cl.scene.grid import Grid
from cloudtomo_cl.scene.phase import DoubleHenyeyGreenstein, HenyeyGreenstein, PhaseFunction, TabulatedPhaseFunction
from cloudtomo_cl.scene.scene import Air, Boundary, Cloud, Scene, Sun, Surface
from cloudtomo_cl.scene.sensors import OrthographicView, PerspectiveView
from cloudtomo_cl.settings.stored import stored_scene
from cloudtomo_cl.settings.tables import PatchPriorTable, read_reconstruct_settings, read_render_settings

SCENE = """
[cloud]
file = "cloud.nc"
[sun]
zenith = 60.0
[[view]]
type = "perspective"
position = [2.4, -1.0, 1.9]
target = [0.6, 0.4, 0.4]
field_of_view = 32.0
pixels = [48, 32]
"""
RUN = '[measurements]\nfile = "images.nc"\n'
GRID = Grid((4, 5, 6), (0.1, 0.1, 0.2))


@pytest.fixture
def folder(tmp_path):
    """A folder with files that settings may name; only their being there is looked at."""
    for name in ("cloud.nc", "images.nc"):
        (tmp_path / name).touch()
    return tmp_path


def scene_error(folder, text):
    """What is said of a scene file."""
    (folder / "scene.toml").write_text(text)
    with pytest.raises(SettingsError) as error:
        read_render_settings(folder / "scene.toml")
    return str(error.value)


def run_error(folder, text):
    """What is said of a run file."""
    (folder / "run.toml").write_text(text)
    with pytest.raises(SettingsError) as error:
        read_reconstruct_settings(folder / "run.toml")
    return str(error.value)


def read_scene(folder, text):
    (folder / "scene.toml").write_text(text)
    return read_render_settings(folder / "scene.toml")


def read_run(folder, text):
    (folder / "run.toml").write_text(text)
    return read_reconstruct_settings(folder / "run.toml")


def test_smallest_scene_has_the_defaults_of_the_api(folder):
    assert read_scene(folder, SCENE).scene(GRID) == Scene(GRID, Sun(zenith=60.0))


def test_every_table_of_a_scene_arrives(folder):
    text = SCENE.replace(
        'file = "cloud.nc"',
        'file = "cloud.nc"\nsingle_scattering_albedo = 0.95\nphase_function = { type = "henyey-greenstein", g = 0.7 }',
    )
    text += '[air]\nextinction = [0.1, 0.05]\n[surface]\nalbedo = 0.4\n[boundary]\nhorizontal = "periodic"\n'
    expected = Scene(
        GRID,
        Sun(zenith=60.0),
        Cloud(0.95, HenyeyGreenstein(0.7)),
        Air((0.1, 0.05)),
        Surface(0.4),
        Boundary("periodic"),
    )
    assert read_scene(folder, text).scene(GRID) == expected


def test_both_projections_are_views(folder):
    text = SCENE + '[[view]]\ntype = "orthographic"\nzenith = 30.0\nwidth = 2.4\npixels = [8, 8]\n'
    assert [type(view) for view in read_scene(folder, text).view] == [PerspectiveView, OrthographicView]


def test_phase_function_with_g_alone_is_henyey_greenstein(folder):
    text = SCENE.replace('file = "cloud.nc"', 'file = "cloud.nc"\nphase_function = { g = 0.5 }')
    assert read_scene(folder, text).cloud.phase_function == HenyeyGreenstein(0.5)


def test_a_table_may_be_written_out(folder):
    table = '{ type = "table", angle = [0, 180], values = [0.1, 0.06], effective_radius = [10] }'
    text = SCENE.replace('file = "cloud.nc"', f'file = "cloud.nc"\nphase_function = {table}')
    expected = TabulatedPhaseFunction((0, 180), (0.1, 0.06), (10,))
    assert read_scene(folder, text).cloud.phase_function == expected


TABLE = TabulatedPhaseFunction((0, 180), ((0.1, 0.06), (0.11, 0.05)), (5, 10), (1, 0.9))
TABLE_FILE = 'phase_function = { type = "table", file = "mie.nc" }\n'


def test_a_table_may_lie_in_a_file_beside_the_settings(folder):
    write_phase_function(folder / "mie.nc", TABLE)
    text = SCENE.replace('file = "cloud.nc"\n', f'file = "cloud.nc"\neffective_radius = 7.0\n{TABLE_FILE}')
    cloud = Cloud(phase_function=TABLE, effective_radius=7.0)
    assert read_scene(folder, text).scene(GRID) == Scene(GRID, Sun(60.0), cloud)


def test_a_run_takes_its_phase_function_from_a_file(folder):
    write_phase_function(folder / "mie.nc", TABLE)
    scene = read_run(folder, f"{RUN}[cloud]\n{TABLE_FILE}").scene(stored_scene(Scene(GRID, Sun(60.0))))
    assert scene == Scene(GRID, Sun(60.0), Cloud(phase_function=TABLE))


def test_the_stored_scene_holds_the_table_itself(folder):
    scene = Scene(GRID, Sun(60.0), Cloud(phase_function=TABLE))
    assert read_run(folder, RUN).scene(json.loads(json.dumps(stored_scene(scene)))) == scene


def test_settings_hold_the_table_itself(folder):
    write_phase_function(folder / "mie.nc", TABLE)
    dumped = read_run(folder, f"{RUN}[cloud]\n{TABLE_FILE}").model_dump(mode="json")
    assert TypeAdapter(PhaseFunction).validate_python(dumped["cloud"]["phase_function"]) == TABLE


def test_a_file_that_is_no_phase_function_is_named(folder):
    with pytest.raises(DataError, match="cloud.nc: not a netCDF file"):
        read_run(folder, f"{RUN}[cloud]\n{TABLE_FILE.replace('mie', 'cloud')}")


def test_files_are_beside_the_settings(folder):
    assert read_scene(folder, SCENE).cloud.file == folder / "cloud.nc"


def test_whole_numbers_are_numbers(folder):
    assert read_scene(folder, SCENE.replace("60.0", "60")).sun.zenith == 60.0


def test_smallest_run_has_the_defaults_of_the_api(folder):
    settings = read_run(folder, RUN)
    defaults = (None, PatchPriorTable(), GaussNewton(), 0)
    assert (settings.stage, settings.prior, settings.solver, settings.run.seed) == defaults


def test_a_key_of_the_other_prior_is_named_with_its_type(folder):
    with pytest.raises(SettingsError, match="prior.smoothness is no key of type 'patches', but of 'smoothness'"):
        read_run(folder, RUN + "[prior]\nsmoothness = 0.1\n")
    assert read_run(folder, RUN + '[prior]\ntype = "smoothness"\nsmoothness = 0.1\n').prior == Prior(smoothness=0.1)


def test_run_takes_the_stored_scene(folder):
    scene = Scene(GRID, Sun(20.0, 30.0), Cloud(0.9, HenyeyGreenstein(0.5)), Air((0.1, 0.2)), Surface(0.3))
    assert read_run(folder, RUN).scene(stored_scene(scene)) == scene


def test_run_replaces_a_table_of_the_stored_scene(folder):
    stored = stored_scene(Scene(GRID, Sun(20.0), surface=Surface(0.3)))
    scene = read_run(folder, RUN + "[surface]\nalbedo = 0.1\n").scene(stored)
    assert scene == Scene(GRID, Sun(20.0), surface=Surface(0.1))


def test_run_without_a_stored_scene_needs_the_sun(folder):
    settings = read_run(folder, RUN + "[grid]\nshape = [4, 4, 4]\nspacing = [0.1, 0.1, 0.1]\n")
    with pytest.raises(SettingsError, match=r"images.nc does not store \[sun\]"):
        settings.scene({})


def test_run_with_a_damaged_stored_scene_names_its_file(folder):
    stored = stored_scene(Scene(GRID, Sun(20.0)))
    stored["sun"]["zenith"] = 95
    with pytest.raises(SettingsError, match=r"images.nc: sun.zenith must be less than 90, is 95"):
        read_run(folder, RUN).scene(stored)


def test_stages_keep_their_order(folder):
    stage = "[[stage]]\ngrid = [{0}, {0}, {0}]\nsamples = 16\niterations = 5\n"
    settings = read_run(folder, RUN + stage.format(4) + stage.format(8))
    assert [stage.grid[0] for stage in settings.stage] == [4, 8]


WRONG_SCENES = {
    "unknown table": ("[cloud]", "[clouds]", "clouds is no known key: did you mean cloud?"),
    "misspelt key": ("zenith", "zenit", "sun.zenit is no known key: did you mean zenith?"),
    "misspelt key of a view": ("field_of_view", "fieldofview", "view[0].fieldofview is no known key: did you mean"),
    "missing key": ("zenith = 60.0", "", "sun.zenith is missing"),
    "out of range": ("32.0", "200.0", "view[0].field_of_view must be less than 180, is 200.0"),
    "text for a number": ("60.0", '"60"', 'sun.zenith must be a number, is "60"'),
    "truth value for a number": ("60.0", "true", "sun.zenith must be a number, is true"),
    "not finite": ("60.0", "nan", "sun.zenith must be less than 90, is NaN"),
    "fraction of a pixel": ("[48, 32]", "[48, 3.5]", "view[0].pixels[1] must be an integer, is 3.5"),
    "two coordinates": ("[2.4, -1.0, 1.9]", "[2.4, -1.0]", "view[0].position[2] is missing"),
    "unknown projection": ('"perspective"', '"fisheye"', "view[0] has type 'fisheye': allowed are 'perspective'"),
    "view below the ground": ("1.9]", "-1.9]", "view[0] is wrong: position lies below the ground"),
    "view from its target": ("[2.4, -1.0, 1.9]", "[0.6, 0.4, 0.4]", "view[0] is wrong: position and target are the"),
    "view looking along up": ("[2.4, -1.0, 1.9]", "[0.6, 0.4, 1.9]\nup = [0, 0, 1]", "view[0] is wrong: up is"),
    "no such file of rays": (
        'type = "perspective"',
        'type = "rays"\nfile = "rays.nc"\n#',
        "view[0].file is wrong: there is no file",
    ),
    "misspelt key of a ring": (
        'type = "perspective"',
        'type = "ring"\nradiuss = 1.0\n#',
        "view[0].radiuss is no known key: did you mean radius?",
    ),
    "one table for a list": ("[[view]]", "[view]", "view must be a list of tables: write [[view]]"),
    "no such file": ("cloud.nc", "clod.nc", "cloud.file is wrong: there is no file"),
    "tables of a run": ("[sun]", "[solver]\n[sun]", "solver is no known key (allowed: air, boundary"),
    "unknown phase function": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "mie", g = 0.5 }',
        "cloud.phase_function has type 'mie': allowed are 'henyey-greenstein', 'double-henyey-greenstein', 'table'",
    ),
    "phase function without a type": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { forward_g = 0.5 }',
        "cloud.phase_function needs a key type",
    ),
    "misspelt key of a phase function": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "double-henyey-greenstein", forwardg = 0.5 }',
        "cloud.phase_function.forwardg is no known key: did you mean forward_g?",
    ),
    "missing key of a phase function": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "double-henyey-greenstein", forward_g = 0.5 }',
        "cloud.phase_function.backward_g is missing",
    ),
    "asymmetry out of range": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { g = 1.0 }',
        "cloud.phase_function.g must be less than or equal to 0.99, is 1.0",
    ),
    "table of a phase function normalised to 4 pi": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "table", angle = [0, 180], values = [1, 1] }',
        "cloud.phase_function is wrong: values[0] integrates to 12.5664 over the sphere",
    ),
    "text in a table of a phase function": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "table", angle = [0, 180], values = [1, "a"] }',
        'cloud.phase_function.values[0][1] must be a number, is "a"',
    ),
    "phase function from a file that is not there": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "table", file = "mei.nc" }',
        "cloud.phase_function is wrong: there is no file",
    ),
    "phase function from a file and more": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = { type = "table", file = "cloud.nc", angle = [0, 180] }',
        "cloud.phase_function is wrong: a phase function from a file is",
    ),
    "phase function that is no table": (
        'file = "cloud.nc"',
        'file = "cloud.nc"\nphase_function = 0.85',
        "cloud.phase_function must be a table, is 0.85",
    ),
    "two ways to say a direction": (
        'type = "perspective"',
        'type = "orthographic"\nwidth = 1.0\nzenith = 3.0\n#',
        "view[0] is wrong: give either position and target, or zenith and azimuth",
    ),
    "air of a negative layer": ("[sun]", "[air]\nextinction = [0.1, -0.1]\n[sun]", "air.extinction[1] must be greater"),
    "air of text": ("[sun]", '[air]\nextinction = "a"\n[sun]', "air.extinction must be a number, is "),
}


@pytest.mark.parametrize("case", WRONG_SCENES)
def test_wrong_scene_is_named(folder, case):
    old, new, message = WRONG_SCENES[case]
    assert old in SCENE
    text = SCENE.replace(old, new)
    if case == "two ways to say a direction":
        text = text.replace("field_of_view = 32.0\n", "")
    assert f"{folder / 'scene.toml'}: {message}" in scene_error(folder, text)


def test_scene_without_views_is_refused(folder):
    assert "view is missing" in scene_error(folder, SCENE[: SCENE.index("[[view]]")])


def test_every_mistake_has_a_line(folder):
    text = SCENE.replace("zenith", "zenit").replace("32.0", "200.0")
    assert len(scene_error(folder, text).splitlines()) == 3  # zenith is missing, zenit is unknown, 200 degrees


def test_a_mistake_in_a_view_is_the_only_one_of_views(folder):
    assert len(scene_error(folder, SCENE.replace("32.0", "200.0")).splitlines()) == 1


def test_not_toml_names_the_line(folder):
    assert "is not TOML" in scene_error(folder, "[cloud\n") and "line 1" in scene_error(folder, "[cloud\n")


def test_absent_file_is_named(tmp_path):
    with pytest.raises(SettingsError, match="absent.toml: no such file"):
        read_render_settings(tmp_path / "absent.toml")


def test_the_cloud_itself_is_no_setting_of_a_reconstruction(folder):
    assert r"write [truth] file" in run_error(folder, RUN + '[cloud]\nfile = "cloud.nc"\n')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "measurements is missing"),
        (RUN + "[solver]\ntyp = 'adam'\n", "solver.typ is no known key: did you mean type?"),
        (RUN + "[solver]\ntype = 'adams'\n", "solver has type 'adams': allowed are 'gauss-newton', 'adam', 'sgd'"),
        (RUN + "[solver]\nbeta1 = 0.5\n", "solver.beta1 is no key of type 'gauss-newton', but of 'adam'"),
        (
            RUN + "[solver]\ntype = 'sgd'\ndamping = 0.5\n",
            "solver.damping is no key of type 'sgd', but of 'gauss-newton'",
        ),
        (
            RUN + "[solver]\nstep_size = 0.5\n",
            "solver.step_size is no key of type 'gauss-newton', but of 'adam' and 'sgd'",
        ),
        (RUN + "[optimizer]\ntype = 'adam'\n", "[optimizer] is now [solver]"),
        (RUN + "[optimizer]\nhalving = 3.0\n", "optimizer.halving is now solver.step_half_life"),
        (RUN + "[prior]\nclear = 3.0\n", "prior.clear is now prior.sparsity_scale"),
        (RUN + "[solver]\ntype = 'adam'\nstep = 3.0\n", "solver.step is now solver.step_size"),
        (RUN + "[solver]\ntype = 'adam'\ngradient = 'field'\n", 'solver.gradient "field" is now'),
        (RUN + "[run]\ntime_limit = 0\n", "run.time_limit must be greater than 0, is 0"),
        (RUN + "[run]\nseed = -1\n", "run.seed must be greater than or equal to 0, is -1"),
        (RUN + "[[stage]]\nsamples = 16\n", "stage[0].grid is missing"),
        (RUN + "[stage]\nsamples = 16\n", "stage must be a list of tables: write [[stage]]"),
    ],
)
def test_wrong_run_is_named(folder, text, message):
    assert f"{folder / 'run.toml'}: {message}" in run_error(folder, text)


@pytest.mark.parametrize(
    "table",
    [Grid, Sun, Cloud, Air, Surface, Boundary, Scene, HenyeyGreenstein, DoubleHenyeyGreenstein, TabulatedPhaseFunction]
    + [PerspectiveView, OrthographicView, Stage, Prior, PatchPriorTable, GaussNewton, Adam, SGD],
)
def test_settings_classes_refuse_unknown_arguments(table):
    with pytest.raises(ValidationError) as error:
        TypeAdapter(table).validate_python({"zenit": 1})
    assert ("zenit",) in [entry["loc"] for entry in error.value.errors()]


def test_a_thousand_mistakes_are_answered_briefly(folder):
    stages = "stage = [" + ",".join(["{grid = [2, 2, 2], grit = 1}"] * 2000) + "]\n"
    assert 20 < len(run_error(folder, stages + RUN).splitlines()) <= 60


@pytest.mark.parametrize("solver", [GaussNewton(), Adam(step_size=0.2)])
def test_a_solver_is_taken_as_it_is(solver):
    assert TypeAdapter(SolverTable).validate_python(solver) == solver
