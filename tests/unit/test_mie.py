"""Mie tables against published efficiencies, intensities and moments, and against direct sums."""

import sys

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss, legval
from scipy.stats import gamma

from cloudtomo_cl.clouds import mie
from cloudtomo_cl.commands.cli import main
from cloudtomo_cl.errors import DataError, MissingPackageError
from cloudtomo_cl.files.phase import read_droplet_table

WATER = 1.331 - 2.15e-8j


@pytest.fixture(scope="module")
def miepython():
    """Imported by the code that is tested: imported earlier it would not be compiled, and slow."""
    try:
        return mie._miepython()
    except MissingPackageError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def table(miepython):
    """Of cloud droplets in red light."""
    return mie.droplet_table(672.0, [4.0, 10.0])


@pytest.mark.parametrize(
    ("index", "size", "extinction", "scattering", "asymmetry"),
    [
        # Wiscombe 1979, NCAR/TN-140+STR, the test cases of MIEV0.
        (0.75, 10.0, 2.232265, 2.232265, 0.896473),
        (0.75, 1000.0, 1.997908, 1.997908, 0.844944),
        (1.33 - 1e-5j, 1.0, 0.093952, 0.093923, 0.184517),
        (1.33 - 1e-5j, 100.0, 2.101321, 2.096594, 0.868959),
        (1.33 - 1e-5j, 10000.0, 2.004089, 1.723857, 0.907840),
        (1.5, 10.0, 2.881999, 2.881999, 0.742913),
        (1.5, 100.0, 2.094388, 2.094388, 0.818246),
        (1.5 - 1j, 100.0, 2.097502, 1.283697, 0.850252),
        (10 - 10j, 100.0, 2.071124, 1.836785, 0.556215),
    ],
)
def test_library_has_wiscombes_efficiencies(miepython, index, size, extinction, scattering, asymmetry):
    found = np.array(miepython.efficiencies_mx(index, size))[[0, 1, 3]]
    np.testing.assert_allclose(found, [extinction, scattering, asymmetry], atol=1.5e-6)


def test_intensities_are_bohren_and_huffmans(miepython):
    # Bohren and Huffman 1983, appendix A: sphere of 0.525 um, index 1.55, at 632.8 nm; S11 at 0, 9 ... 180 degrees.
    published = (
        "0.100000E+01 0.785390E+00 0.356897E+00 0.766119E-01 0.355355E-01 0.701845E-01 0.574313E-01 "
        "0.219660E-01 0.125959E-01 0.173750E-01 0.124601E-01 0.679093E-02 0.954239E-02 0.863419E-02 "
        "0.227421E-02 0.543998E-02 0.160243E-01 0.188852E-01 0.195254E-01 0.301676E-01 0.383189E-01"
    )
    coefficients = miepython.coefficients(1.55, 2 * np.pi * 0.525 / 0.6328)
    functions = mie._angular_functions(np.cos(np.radians(np.arange(0.0, 181.0, 9.0))), coefficients.shape[1])
    intensity = mie._intensity([coefficients], functions)[0]
    np.testing.assert_allclose(intensity / intensity[0], np.array(published.split(), float), rtol=2e-5)


def test_moments_are_those_of_cloud_c1(miepython):
    # Garcia and Siewert 1985: cloud C1 of Deirmendjian 1969 at 0.7 um, (2 l + 1) times the moment of P_l.
    published = [1, 2.544, 3.883, 4.568, 5.235, 5.887, 6.457, 7.177, 7.859, 8.494, 9.286, 9.856, 10.615]
    # n(r) ~ r^6 exp(-1.5 r) has an effective radius of (6 + 3) / 1.5 and a variance of 1 / (6 + 3).
    function = mie.droplet_table(700.0, 6.0, 1 / 9, 1.33).phase_function
    nodes, weights = leggauss(8)
    edges = np.cos(np.radians(function.angle))[::-1]
    half = np.diff(edges) / 2
    cosine = (edges[:-1] + half)[:, None] + half[:, None] * nodes
    density = 2 * np.pi * function.density(cosine) * half[:, None] * weights
    moments = [(2 * order + 1) * (density * legval(cosine, np.eye(13)[order])).sum() for order in range(13)]
    np.testing.assert_allclose(moments, published, atol=4e-3)


def test_tiny_droplets_scatter_as_rayleigh_has_it(miepython):
    function = mie.droplet_table(1000.0, 1e-3, refractive_index=1.33).phase_function
    cosine = np.linspace(-1, 1, 41)
    np.testing.assert_allclose(function.density(cosine), 3 / (16 * np.pi) * (1 + cosine**2), rtol=5e-3)


def test_table_is_the_direct_sum_at_other_angles_and_sizes(miepython, table):
    """The library's own amplitudes, on other sizes: errs by interpolation (0.3 %) and sizes (0.5 %)."""
    generator = np.random.default_rng(1)
    angle = np.concatenate([generator.uniform(0, 3, 12), generator.uniform(3, 170, 30), generator.uniform(170, 180, 8)])
    cosine = np.cos(np.radians(angle))
    scale = 2 * np.pi / 0.672 * 4.0 * 0.1
    sizes = np.arange(gamma.ppf(1e-7, 10) * scale, gamma.isf(1e-9, 10) * scale, 0.023)
    weights = gamma.pdf(sizes, 10, scale=scale)
    intensity = np.zeros(len(angle))
    for weight, size in zip(weights, sizes):
        # Normalised to the scattering efficiency over the sphere.
        intensity += weight * miepython.i_unpolarized(WATER, size, cosine, norm="qsca")
    scattering = weights @ [miepython.efficiencies_mx(WATER, size)[1] for size in sizes]
    np.testing.assert_allclose(table.phase_function.density(cosine, 0), intensity / scattering, rtol=8e-3)


def test_asymmetry_is_the_mean_over_the_sizes(miepython, table):
    scale = 2 * np.pi / 0.672 * 10.0 * 0.1
    sizes = np.arange(gamma.ppf(1e-7, 10) * scale, gamma.isf(1e-9, 10) * scale, 0.05)
    _, scattering, _, asymmetry = np.array([miepython.efficiencies_mx(WATER, size) for size in sizes]).T
    weights = gamma.pdf(sizes, 10, scale=scale) * scattering
    assert table.phase_function.asymmetry()[1] == pytest.approx(weights @ asymmetry / weights.sum(), abs=2e-4)


def test_cloud_in_red_light_has_the_known_asymmetry(table):
    assert table.phase_function.asymmetry()[1] == pytest.approx(0.86, abs=0.005)


def test_extinction_efficiency_nears_two_as_the_edge_effect_has_it(table):
    # Nussenzveig and Wiscombe 1980, Eq. 3: Q = 2 + 1.9924 x^(-2/3) + ...
    size = 2 * np.pi * 10.0 / 0.672
    assert table.extinction_efficiency[1] == pytest.approx(2 + 1.9924 * size ** (-2 / 3), rel=0.01)


def test_weak_absorption_is_that_of_geometric_optics_and_more(table):
    # Bohren and Huffman 1983, Eq. 7.2; light that passes outside of the edge adds up to 40 % (Wiscombe's case of
    # 1.33 - 1e-5i at x = 100).
    size = 2 * np.pi / 0.672 * np.array([4.0, 10.0])
    n, k = table.refractive_index_real, table.refractive_index_imag
    least = 8 / 3 * size * k / n * (n**3 - (n**2 - 1) ** 1.5) / np.array(table.extinction_efficiency)
    ratio = (1 - np.array(table.phase_function.single_scattering_albedo)) / least
    assert ((ratio > 1) & (ratio < 1.4)).all()


def test_rainbow_and_glory_are_there(table):
    angle = np.arange(125.0, 180.01, 0.1)
    density = table.phase_function.density(np.cos(np.radians(angle)), 1)
    bow = (angle > 130) & (angle < 160)
    # Descartes' 137.9 degrees for n = 1.331, from which Airy's theory moves the maximum to larger angles.
    assert 137.9 < angle[bow][np.argmax(density[bow])] < 143
    assert density[-1] > 4 * density[np.argmin(np.abs(angle - 168))]


def test_narrow_and_wide_tables_agree_where_they_overlap(miepython, table):
    alone = mie.droplet_table(672.0, 4.0)
    assert alone.extinction_efficiency[0] == pytest.approx(table.extinction_efficiency[0], rel=2e-4)
    assert alone.phase_function.g == pytest.approx(table.phase_function.asymmetry()[0], abs=2e-4)


def test_sign_of_absorption_does_not_matter(miepython):
    one, other = (mie.droplet_table(2000.0, 1.0, refractive_index=complex(1.3, sign * 1e-3)) for sign in (1, -1))
    assert one == other and one.phase_function.single_scattering_albedo[0] < 1


def test_progress_ends_with_all_sizes(miepython):
    calls = []
    mie.droplet_table(2000.0, 1.0, progress=lambda *call: calls.append(call))
    assert calls[-1][0] == calls[-1][1] and all(done <= total for done, total in calls)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 5.0), "wavelength is -1 nm: it must be greater than 0"),
        ((672.0, [10.0, 5.0]), r"effective_radius is \[10.0, 5.0\]: it must increase"),
        ((672.0, [0.0]), "all greater than 0"),
        ((672.0, []), "must be a list of micrometres"),
        ((672.0, 5.0, 0.6), "effective_variance is 0.6: it must lie between 0.001 and 0.4"),
        ((672.0, 5.0, 0.1, 0j), "it must be finite, with a positive real part"),
        ((672.0, 5000.0), "choose a smaller effective radius or a longer wavelength"),
        ((10000.0, 5.0), "give the refractive index too"),
    ],
)
def test_what_is_impossible_is_named(miepython, arguments, message):
    with pytest.raises(DataError, match=message):
        mie.droplet_table(*arguments)


def test_missing_library_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "miepython", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'miepython >= 3.0.2'"):
        mie.droplet_table(672.0, 5.0)


def test_command_writes_a_table(miepython, tmp_path, capsys):
    output, png = tmp_path / "mie.nc", tmp_path / "mie.png"
    options = ["--wavelength", "2000", "--effective-radius", "1", "2", "--count", "3", "--png", str(png)]
    assert main(["mie", *options, "--output", str(output)]) == 0
    assert read_droplet_table(output).phase_function.effective_radius == (1.0, 1.5, 2.0)
    assert png.stat().st_size > 0
    assert "radius 1.5 um: asymmetry 0." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--effective-radius", "5", "--count", "3"], "--count 3 with 1 radii: it needs the first and the last"),
        (["--effective-radius", "5", "3"], "effective_radius is [5.0, 3.0]: it must increase"),
        (["--effective-radius", "5", "--effective-variance", "0.9"], "effective_variance is 0.9"),
    ],
)
def test_command_names_mistakes(miepython, tmp_path, capsys, options, message):
    assert main(["mie", "--wavelength", "672", *options, "--output", str(tmp_path / "mie.nc")]) == 2
    assert message in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
