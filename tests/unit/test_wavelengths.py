"""One scene at several wavelengths: files, and the extinction that follows from the droplets."""

import numpy as np
import pytest
import xarray as xr

import cloudtomo_cl as ct
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError, MissingPackageError, SettingsError
from cloudtomo_cl.files.extinction import read_extinction_wavelength
from cloudtomo_cl.files.truth import read_truth
from cloudtomo_cl.settings.scenes import read_scene_file

GRID = ct.Grid((5, 4, 6), (0.05, 0.05, 0.05))
EXTINCTION = ct.cumulus(GRID, seed=3, peak=60.0)
VIEW = ct.OrthographicView(zenith=20.0, azimuth=0.0, width=0.3, pixels=(4, 3))
SCENE = """
[cloud]
file = "cloud.nc"
phase_function = { type = "table", file = "mie.nc" }
effective_radius = 8.0
[sun]
zenith = 30.0
[[view]]
type = "orthographic"
zenith = 20.0
width = 0.3
pixels = [4, 3]
[spectrum]
wavelengths = [672.0, 2130.0]
"""


def table(wavelength, efficiency=(2.2, 2.1), albedo=(1.0, 1.0), radii=(4.0, 12.0)):
    """Droplets that scatter evenly, with a larger albedo for smaller ones."""
    function = ct.TabulatedPhaseFunction([0, 90, 180], [[1 / (4 * np.pi)] * 3] * len(radii), radii, albedo)
    return ct.DropletTable(function, efficiency, wavelength, 0.1, 1.33, 1e-8)


def images(wavelength, bright):
    values = np.full((3, 4), bright) + np.arange(12).reshape(3, 4)
    return ct.Measurements((VIEW,), (values,), (0.1 * values,), wavelength=wavelength)


RED, INFRARED = images(672.0, 1.0), images(2130.0, 50.0)


def same(one, other):
    return (
        one.views == other.views
        and one.wavelength == other.wavelength
        and all(map(np.array_equal, one.images, other.images))
        and all(map(np.array_equal, one.standard_errors, other.standard_errors))
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    ct.write_extinction("cloud.nc", GRID, EXTINCTION)
    ct.write_phase_function("mie.nc", [table(672.0), table(2130.0, (2.4, 2.2), (0.99, 0.97))])
    return tmp_path


def test_images_of_several_wavelengths_come_back_one_by_one(folder):
    ct.write_measurements("images.nc", [RED, INFRARED])
    assert ct.read_wavelengths("images.nc") == (672.0, 2130.0)
    for written in (RED, INFRARED):
        assert same(ct.read_measurements("images.nc", written.wavelength), written)


def test_the_file_has_a_coordinate_with_a_unit(folder):
    ct.write_measurements("images.nc", [RED, INFRARED])
    with xr.open_dataset("images.nc") as dataset:
        assert dataset.radiance.dims == ("wavelength", "view", "row", "column")
        assert dataset.wavelength.attrs["units"] == "nm" and "wavelength" not in dataset.image_width.dims
        assert dataset.radiance.sel(wavelength=2130).max() == INFRARED.images[0].max()


def test_one_wavelength_has_no_dimension(folder):
    ct.write_measurements("one.nc", RED)
    with xr.open_dataset("one.nc") as dataset:
        assert dataset.radiance.dims == ("view", "row", "column") and dataset.wavelength == 672.0
    assert same(ct.read_measurements("one.nc"), RED) and same(ct.read_measurements("one.nc", 672.0), RED)


def test_the_only_wavelength_of_a_dimension_need_not_be_chosen():
    dataset = ct.measurements_dataset([RED, INFRARED]).isel(wavelength=[1])
    assert same(ct.read_measurements(dataset), INFRARED)


def test_images_without_a_wavelength_are_written_as_ever(folder):
    dataset = ct.measurements_dataset(ct.Measurements(RED.views, RED.images, RED.standard_errors))
    assert "wavelength" not in dataset.variables and ct.read_measurements(dataset).wavelength is None


def test_micrometres_are_converted(folder):
    dataset = ct.measurements_dataset([RED, INFRARED])
    dataset = dataset.assign_coords(wavelength=("wavelength", [0.672, 2.13], {"units": "um"}))
    assert ct.read_wavelengths(dataset) == (672.0, 2130.0)
    assert same(ct.read_measurements(dataset, 672.0), RED)


@pytest.mark.parametrize(
    ("wavelength", "message"),
    [
        (None, r"images.nc: holds 672, 2130 nm: choose one: \[measurements\] wavelength"),
        (865.0, "images.nc: has no 865 nm: it holds 672, 2130 nm"),
    ],
)
def test_a_wavelength_must_be_chosen_of_those_that_are_there(folder, wavelength, message):
    ct.write_measurements("images.nc", [RED, INFRARED])
    with pytest.raises(DataError, match=message):
        ct.read_measurements("images.nc", wavelength)


def test_a_file_that_says_no_wavelength_has_none_to_choose(folder):
    ct.write_measurements("images.nc", ct.Measurements(RED.views, RED.images, RED.standard_errors))
    with pytest.raises(DataError, match="does not say its wavelength, so none can be chosen: leave out 672 nm"):
        ct.read_measurements("images.nc", 672.0)


def test_wavelengths_without_units_may_be_micrometres(folder):
    dataset = ct.measurements_dataset([RED, INFRARED]).assign_coords(wavelength=("wavelength", [0.672, 2.13]))
    with pytest.raises(DataError, match="wavelength has no units, and is 0.672: set its attribute units, likely um"):
        ct.read_measurements(dataset, 672.0)


@pytest.mark.parametrize(
    ("several", "message"),
    [
        ([], "there are no images to write"),
        ([INFRARED, RED], "the wavelengths are 2130, 672 nm: they must increase"),
        ([RED, RED], "the wavelengths are 672, 672 nm: they must increase"),
        ([images(None, 1.0), RED], "give each its own"),
        (
            [
                RED,
                ct.Measurements(
                    (ct.OrthographicView(zenith=0.0, width=1.0, pixels=(4, 3)),),
                    RED.images,
                    RED.images,
                    wavelength=865.0,
                ),
            ],
            "must have the same views",
        ),
    ],
)
def test_what_does_not_go_into_one_file_is_refused(several, message):
    with pytest.raises(DataError, match=message):
        ct.measurements_dataset(several)


def test_an_impossible_wavelength_is_refused():
    with pytest.raises(DataError, match="wavelength is -1: it must be above 0 nm"):
        ct.Measurements(RED.views, RED.images, RED.standard_errors, wavelength=-1)


def test_a_scene_at_another_wavelength_than_the_images_is_refused(device):
    scene = ct.Scene(GRID, ct.Sun(30.0), wavelength=2130.0)
    for solve in (ct.Problem.of, ct.reconstruct):
        with pytest.raises(DataError, match="the scene is at 2130 nm, the images are of 672 nm"):
            solve(scene, RED, device=device)


def test_tables_of_several_wavelengths_come_back_one_by_one(folder):
    assert ct.read_wavelengths("mie.nc") == (672.0, 2130.0)
    assert ct.read_droplet_table("mie.nc", 672.0) == table(672.0)
    assert ct.read_phase_function("mie.nc", 2130.0) == table(2130.0, albedo=(0.99, 0.97)).phase_function
    with pytest.raises(DataError, match="mie.nc: holds 672, 2130 nm: choose one"):
        ct.read_phase_function("mie.nc")


def test_a_table_of_another_wavelength_is_refused(folder):
    ct.write_phase_function("one.nc", table(672.0))
    assert ct.read_wavelengths("one.nc") == (672.0,)
    assert ct.read_droplet_table("one.nc", 672.0) == ct.read_droplet_table("one.nc") == table(672.0)
    with pytest.raises(DataError, match="one.nc: has no 2130 nm: it holds 672 nm"):
        ct.read_phase_function("one.nc", 2130.0)


def test_tables_that_differ_in_more_than_the_wavelength_do_not_go_into_one_file(tmp_path):
    with pytest.raises(DataError, match="the same angles, radii and variance: use droplet_tables"):
        ct.write_phase_function(tmp_path / "mie.nc", [table(672.0), table(2130.0, radii=(4.0, 13.0))])


def test_extinction_follows_from_the_water_whatever_it_is_at():
    water, radius = np.array([0.0, 0.2, 0.5]), np.array([np.nan, 5.0, 11.0])
    red, infrared = table(672.0), table(2130.0, (2.4, 2.2))
    expected = ct.extinction_from_water(water, radius, infrared)
    for reference in (red, None):
        known = ct.extinction_from_water(water, radius, reference)
        np.testing.assert_allclose(ct.extinction_at(known, radius, infrared, reference), expected, rtol=1e-14)


def test_extinction_at_another_wavelength_needs_radii_of_the_table():
    with pytest.raises(DataError, match="effective_radius is 20 to 20 micrometres, the table has 4 to 12"):
        ct.extinction_at(np.ones(2), 20.0, table(672.0))
    with pytest.raises(DataError, match="greater than 0 micrometres where there is cloud"):
        ct.extinction_at(np.ones(2), np.array([np.nan, 5.0]), table(672.0))


def test_a_scene_file_has_the_droplets_extinction_at_each_wavelength(folder):
    read = read_scene_file(folder / "scene.toml")
    assert [scene.wavelength for scene in read.scenes] == [672.0, 2130.0]
    assert [scene.cloud.phase_function.single_scattering_albedo for scene in read.scenes] == [(1, 1), (0.99, 0.97)]
    # 8 um are half-way between the radii of the table.
    np.testing.assert_array_equal(read.extinctions[0], EXTINCTION)
    np.testing.assert_allclose(read.extinctions[1], EXTINCTION * 2.3 / 2.15, rtol=1e-6)


def test_the_radii_of_the_cloud_take_the_place_of_one(folder):
    radius = np.where(EXTINCTION > 0, np.linspace(4, 12, EXTINCTION.size).reshape(EXTINCTION.shape), np.nan)
    ct.write_extinction("cloud.nc", GRID, EXTINCTION, effective_radius=radius)
    read = read_scene_file(folder / "scene.toml")
    share = (np.nan_to_num(radius, nan=4.0) - 4) / 8
    ratio = (2.4 - 0.2 * share) / (2.2 - 0.1 * share)
    np.testing.assert_allclose(read.extinctions[1], EXTINCTION * ratio, rtol=1e-6)


@pytest.mark.parametrize(("known", "at"), [(672.0, (2.15, 2.3)), (2130.0, (2.15, 2.3)), (0.0, (2.15, 2.3))])
def test_the_cloud_says_at_which_wavelength_it_is(folder, known, at):
    ct.write_extinction("cloud.nc", GRID, EXTINCTION, wavelength=known)
    assert read_extinction_wavelength("cloud.nc") == known
    before = {672.0: 2.15, 2130.0: 2.3, 0.0: 2.0}[known]
    for extinction, efficiency in zip(read_scene_file(folder / "scene.toml").extinctions, at):
        np.testing.assert_allclose(extinction, EXTINCTION * efficiency / before, rtol=1e-6)


def test_a_file_of_images_is_a_cloud_at_each_of_its_wavelengths(folder):
    ct.write_measurements("images.nc", [RED, INFRARED], cloud=(GRID, [EXTINCTION, 3 * EXTINCTION], None))
    read = read_scene_file(folder / "scene.toml", ['cloud.file="images.nc"'])
    for extinction, factor in zip(read.extinctions, (1, 3)):
        np.testing.assert_array_equal(extinction, factor * EXTINCTION)
    with pytest.raises(DataError, match="images.nc: has no 865 nm"):
        read_scene_file(
            folder / "scene.toml",
            ['cloud.file="images.nc"', "spectrum.wavelengths=[865.0]", "cloud.phase_function={g=0.8}"],
        )


def test_a_reference_may_be_said_in_the_scene(folder):
    read = read_scene_file(folder / "scene.toml", ["spectrum.reference=2130"])
    np.testing.assert_array_equal(read.extinctions[1], EXTINCTION)


def test_water_is_turned_into_extinction_at_the_wavelength_of_its_table(folder):
    water = xr.Dataset(
        {
            "lwc": (("x", "y", "z"), np.full(GRID.shape, 0.3), {"units": "g m-3"}),
            "reff": (("x", "y", "z"), np.full(GRID.shape, 8.0), {"units": "um"}),
        },
        {name: (name, GRID.centres(axis), {"units": "km"}) for axis, name in enumerate("xyz")},
    )
    ct.write_phase_function("red.nc", table(672.0))
    for options, expected in ((None, 0.0), (ct.ReadingOptions(droplet_table="red.nc"), 672.0)):
        volume = ct.read_cloud(water, options)
        assert volume.wavelength == expected == volume.coarsened((1, 2, 2)).wavelength == volume.rotated(90).wavelength
        kept = ct.extinction_dataset(GRID, volume.extinction, None, volume.effective_radius, wavelength=expected)
        assert ct.read_cloud(kept).wavelength == expected


@pytest.mark.parametrize("wavelength", [672, 2130])
def test_the_command_chooses_a_wavelength_of_the_table(folder, wavelength, capsys):
    (folder / "water.txt").write_text("# rico\n3 3 3\n0.1 0.1 0.1 0.2 0.3\n1 1 1 0.3 8.0\n1 1 2 0.5 9.0\n")
    command = "cloud water.txt --droplet-table mie.nc --output water.nc --quiet"
    assert main(command.split()) == 2 and "--wavelength of cloudtomo cloud" in capsys.readouterr().err
    assert main(f"{command} --wavelength {wavelength}".split()) == 0
    assert read_extinction_wavelength("water.nc") == wavelength
    water = ct.extinction_from_water(0.5, 9.0, ct.read_droplet_table("mie.nc", wavelength))
    assert ct.read_extinction("water.nc")[1].max() == pytest.approx(float(water), rel=1e-6)
    assert main("cloud water.txt --wavelength 672 --quiet".split()) == 2
    assert "--wavelength has no effect: it chooses from a --droplet-table" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("spectrum.wavelengths=[2130.0, 672.0]", "wavelengths must increase, in nm"),
        ("spectrum.irradiance=[1.0]", "irradiance has 1 entries for 2 wavelengths"),
        ("spectrum.wavelength=[1.0]", "spectrum.wavelength is no known key: did you mean wavelengths"),
        ("air.wavelength=550.0", r"air.wavelength: \[spectrum\] says the wavelengths, leave it out"),
        ("air.extinction=0.01", "air.extinction is that of one wavelength, and there are 2"),
        ('cloud.phase_function={ type = "henyey-greenstein", g = 0.85 }', "there is no table of them"),
    ],
)
def test_what_a_spectrum_cannot_be_is_named(folder, override, message):
    with pytest.raises(SettingsError, match=message):
        read_scene_file(folder / "scene.toml", [override])


def test_droplets_of_unknown_size_are_named(folder):
    (folder / "scene.toml").write_text(SCENE.replace("effective_radius = 8.0\n", ""))
    with pytest.raises(SettingsError, match=r"which .*cloud.nc does not have: give cloud.effective_radius \(um\)"):
        read_scene_file(folder / "scene.toml")


def test_a_wavelength_that_the_table_has_not_is_named(folder):
    with pytest.raises(DataError, match="mie.nc: has no 865 nm: it holds 672, 2130 nm"):
        read_scene_file(folder / "scene.toml", ["spectrum.wavelengths=[672.0, 865.0]"])


def test_sun_surface_and_air_are_those_of_the_wavelength(folder):
    more = [
        "spectrum.irradiance=[1.5, 0.1]",
        "spectrum.surface_albedo=[0.05, 0.02]",
        "air.single_scattering_albedo=1.0",
    ]
    red, infrared = read_scene_file(folder / "scene.toml", more).scenes
    assert (red.sun.irradiance, infrared.sun.irradiance) == (1.5, 0.1)
    assert (red.surface.albedo, infrared.surface.albedo) == (0.05, 0.02)
    assert red.air.wavelength == 672.0 and infrared.air_layers()[1].max() < red.air_layers()[1].max() / 50


def test_a_truth_at_another_wavelength_is_none(folder):
    ct.write_extinction("cloud.nc", GRID, EXTINCTION, wavelength=672.0)
    assert np.array_equal(read_truth("cloud.nc", GRID, 672.0), EXTINCTION)
    with pytest.raises(SettingsError, match="has its extinction at 672 nm, the images are of 2130 nm: take the images"):
        read_truth("cloud.nc", GRID, 2130.0)


def test_the_images_file_has_the_truth_at_each_wavelength(folder):
    ct.write_measurements("images.nc", [RED, INFRARED], cloud=(GRID, [EXTINCTION, 2 * EXTINCTION], None))
    assert np.array_equal(read_truth("images.nc", GRID, 2130.0), 2 * EXTINCTION)


def test_fluxes_are_of_one_wavelength(folder, capsys):
    assert main(["flux", "scene.toml"]) == 2
    assert "spectrum.wavelengths: fluxes are of one wavelength, for instance with --set" in capsys.readouterr().err


@pytest.fixture(scope="module")
def tables():
    try:
        return ct.droplet_tables([1000.0, 2000.0], [1.0, 2.0])
    except MissingPackageError as error:
        pytest.skip(str(error))


def test_tables_of_several_wavelengths_have_the_same_angles(tables):
    assert len({one.phase_function.angle for one in tables}) == 1
    assert [one.wavelength_nm for one in tables] == [1000.0, 2000.0]


def test_each_of_several_tables_is_that_of_its_wavelength(tables):
    for one in tables:
        alone = ct.droplet_table(one.wavelength_nm, [1.0, 2.0])
        assert one.extinction_efficiency == alone.extinction_efficiency
        assert one.phase_function.single_scattering_albedo == alone.phase_function.single_scattering_albedo
        cosine = np.linspace(-1, 1, 201)
        for row in range(2):
            found, expected = (table.phase_function.density(cosine, row) for table in (one, alone))
            np.testing.assert_allclose(found, expected, rtol=5e-3)


def test_extinction_follows_miepythons_efficiencies(tables):
    """The ratio of the efficiencies of two wavelengths, summed over sizes that miepython alone was asked for."""
    from scipy.stats import gamma

    from cloudtomo_cl.clouds import mie
    from cloudtomo_cl.scene.water import water_refractive_index

    library = mie._miepython()
    efficiencies = []
    for wavelength in (1000.0, 2000.0):
        scale = 2 * np.pi / (wavelength / 1e3) * 2.0 * 0.1
        sizes = np.arange(gamma.ppf(1e-7, 10) * scale, gamma.isf(1e-9, 10) * scale, 0.03)
        weights = gamma.pdf(sizes, 10, scale=scale)
        index = water_refractive_index(wavelength)
        efficiencies.append(weights @ [library.efficiencies_mx(index, size)[0] for size in sizes] / weights.sum())
    changed = ct.extinction_at(np.array([10.0]), 2.0, tables[1], tables[0])
    assert changed[0] == pytest.approx(10 * efficiencies[1] / efficiencies[0], rel=1e-4)


def test_the_command_makes_tables_of_several_wavelengths(tables, folder, capsys):
    command = "mie --wavelength 1000 2000 --effective-radius 1 2 --output both.nc --png both.png"
    assert main(command.split()) == 0
    assert [ct.read_droplet_table("both.nc", one) for one in (1000.0, 2000.0)] == list(tables)
    assert "2000 nm\n" in capsys.readouterr().out and (folder / "both.png").stat().st_size > 0
    assert main([*command.replace("both", "no").split(), "--refractive-index", "1.3", "0"]) == 2
    assert "--refractive-index is of one wavelength, and there are 2" in capsys.readouterr().err
