/* I3RC's step cloud once more, by nothing that the package uses: forward photons, Woodcock tracking,
 * double precision, local estimates straight up and down. For docs/decisions/i3rc-tolerance.md.
 *
 *   cc -O3 -o step_cloud scripts/step_cloud_woodcock.c -lm
 *   ./step_cloud 1e7 7 0.5 1       photons, seed, cosine of the sun's zenith angle, single-scattering albedo
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static const double PI = 3.14159265358979323846;
static const double LENGTH = 0.5, HEIGHT = 0.25; /* km */
static const double THIN = 8.0, THICK = 72.0;    /* km^-1: optical depths 2 and 18 */
static const double G = 0.85;

/* Splitmix64 (Steele, Lea and Flood 2014) in the open interval (0, 1). */
static uint64_t state;
static double uniform(void)
{
    uint64_t z = (state += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    z ^= z >> 31;
    return ((double)(z >> 11) + 0.5) / 9007199254740992.0;
}

/* Henyey-Greenstein with mean 1 over the sphere. */
static double phase_function(double cosine) { return (1 - G * G) / pow(1 + G * G - 2 * G * cosine, 1.5); }

static void scatter(double d[3])
{
    const double q = (1 - G * G) / (1 - G + 2 * G * uniform());
    const double cosine = (1 + G * G - q * q) / (2 * G), sine = sqrt(fmax(0, 1 - cosine * cosine));
    const double angle = 2 * PI * uniform();
    const double p = sine * cos(angle), s = sine * sin(angle), across = sqrt(d[0] * d[0] + d[1] * d[1]);
    if (across < 1e-9) {
        d[0] = p, d[1] = s, d[2] = d[2] > 0 ? cosine : -cosine;
        return;
    }
    const double x = d[0], y = d[1], z = d[2];
    d[0] = x * cosine + (x * z * p - y * s) / across;
    d[1] = y * cosine + (y * z * p + x * s) / across;
    d[2] = z * cosine - across * p;
}

static void print(const char *name, double sum, double square, double n)
{
    const double mean = sum / n;
    printf("%s %.5f +- %.5f\n", name, mean, sqrt((square / n - mean * mean) / n));
}

int main(int count, char **words)
{
    if (count != 5) {
        fputs("usage: step_cloud PHOTONS SEED SUN_COSINE ALBEDO\n", stderr);
        return 2;
    }
    const double photons = atof(words[1]), sun = atof(words[3]), albedo = atof(words[4]);
    double sums[4] = {0}, squares[4] = {0}; /* R, T, nadir, zenith */
    state = strtoull(words[2], NULL, 10) * 0x2545f4914f6cdd1dULL;
    for (double k = 0; k < photons; ++k) {
        double x = LENGTH * uniform(), z = HEIGHT, weight = 1, value[4] = {0};
        double d[3] = {sqrt(1 - sun * sun), 0, -sun};
        while (weight > 0) {
            const double flight = -log(uniform()) / THICK;
            x += flight * d[0];
            x -= LENGTH * floor(x / LENGTH);
            z += flight * d[2];
            if (z >= HEIGHT || z <= 0) {
                value[z <= 0] += weight;
                break;
            }
            const double extinction = x < LENGTH / 2 ? THIN : THICK;
            if (uniform() * THICK >= extinction)
                continue; /* a virtual collision */
            weight *= albedo;
            /* pi L / (mu0 F0): pi times the phase function over 4 pi. */
            value[2] += weight * phase_function(d[2]) / 4 * exp(-extinction * (HEIGHT - z));
            value[3] += weight * phase_function(-d[2]) / 4 * exp(-extinction * z);
            if (weight < 0.1)
                weight = uniform() < 0.5 ? 0 : 2 * weight;
            scatter(d);
        }
        for (int i = 0; i < 4; ++i)
            sums[i] += value[i], squares[i] += value[i] * value[i];
    }
    const char *names[] = {"R", "T", "nadir", "zenith"};
    for (int i = 0; i < 4; ++i)
        print(names[i], sums[i], squares[i], photons);
    return 0;
}
