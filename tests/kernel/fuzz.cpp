// Solve random problems with NaN, infinities, zeros and numbers of 1e+-300 among their data, and judge each answer by
// arithmetic in extended precision that shares no code with the solver.
//
//     fuzz COUNT SEED
//
// Prints the number of each verdict; the exit code is 1 where forces that are called allowed are not.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <vector>

#include "one_grasp_c.h"

using Wide = long double;

static const double SPECIAL[] = {NAN,   INFINITY, -INFINITY, 0,      -0.0,  1e300, -1e300, 1e-300, -1e-300, 1e123,
                                 1e-123, 5e-324,  1e-160,    1e160,  1,     -1,    1e10,   1e-10};

struct Case {
  // Arrays of exact size on the heap, so that the address sanitizer finds what is read beyond them.
  std::vector<double> points, normals, friction, squeeze, wrench, weights, present, torsion, low, high, forces, moments;
  jaxgrasp_problem problem = {};
};

static void draw(std::mt19937_64& generator, Case& c) {
  std::uniform_real_distribution<double> uniform(0, 1);
  std::normal_distribution<double> normal;
  const auto u = [&] { return uniform(generator); };
  const int n = u() < 0.05 ? int(u() * (JAXGRASP_MAX_CONTACTS + 2)) : int(u() * 8);
  const double share = u() < 0.3 ? 0 : 0.3 * u() * u(), scale = u() < 0.2 ? std::pow(10, 300 * u() - 150) : 1;
  const auto fill = [&](std::vector<double>& array, int size, auto number) {
    array.resize(size);
    for (double& x : array) {
      x = number();
      if (u() < share) x = SPECIAL[generator() % (sizeof SPECIAL / sizeof *SPECIAL)];
    }
  };
  fill(c.points, 3 * n, [&] { return scale * normal(generator); });
  fill(c.normals, 3 * n, [&] { return normal(generator); });
  fill(c.friction, n, u);
  fill(c.squeeze, n, [&] { return 5 * u(); });
  fill(c.wrench, 6, [&] { return normal(generator); });
  fill(c.weights, n, u);
  fill(c.present, n, [&] { return u() < 0.8 ? 1.0 : 0.0; });
  fill(c.torsion, n, [&] { return 0.01 * u(); });
  fill(c.low, n, u);
  fill(c.high, n, [&] { return 1 + 5 * u(); });
  c.forces.assign(3 * n, 0);
  c.moments.assign(n, 0);
  static const double nothing = 0;
  const auto data = [&](const std::vector<double>& array) { return n > 0 ? array.data() : &nothing; };
  jaxgrasp_problem& p = c.problem;
  p.n_contacts = n;
  p.points = data(c.points), p.normals = data(c.normals), p.friction = data(c.friction), p.squeeze = data(c.squeeze);
  p.wrench = c.wrench.data();
  p.weights = u() < 0.4 ? data(c.weights) : nullptr;
  p.present = u() < 0.3 ? data(c.present) : nullptr;
  p.torsion = u() < 0.3 ? data(c.torsion) : nullptr;
  p.normal_min = u() < 0.2 ? data(c.low) : nullptr;
  p.normal_max = u() < 0.2 ? data(c.high) : nullptr;
}

static Wide norm(const Wide a[3]) { return sqrtl(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

static void subtract_cross(Wide out[3], const Wide a[3], const Wide b[3]) {
  for (int i = 0; i < 3; i++) out[i] -= a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
}

// Whether the forces balance the wrench inside the cones and bounds, to 1e-6 of the numbers that are summed.
static bool is_allowed(const Case& c) {
  const jaxgrasp_problem& p = c.problem;
  const int n = p.n_contacts;
  const auto is_present = [&](int i) { return p.present == nullptr || p.present[i] > 0.5; };
  Wide centre[3] = {0, 0, 0}, spread = 0, distance = 0, total = 0, moments = 0;
  int count = 0;
  for (int i = 0; i < n; i++) {
    for (int j = 0; j < 3; j++) {
      if (!std::isfinite(c.forces[3 * i + j]) || !std::isfinite(c.moments[i])) return false;
      if (!is_present(i) && c.forces[3 * i + j] != 0) return false;
      if (is_present(i)) centre[j] += c.points[3 * i + j];
    }
    const Wide f[3] = {c.forces[3 * i], c.forces[3 * i + 1], c.forces[3 * i + 2]};
    count += is_present(i), total += norm(f), moments += fabsl(c.moments[i]);
  }
  for (int j = 0; j < 3; j++) centre[j] /= count > 0 ? count : 1, distance = fmaxl(distance, fabsl(centre[j]));
  Wide force[3] = {c.wrench[0], c.wrench[1], c.wrench[2]}, torque[3] = {c.wrench[3], c.wrench[4], c.wrench[5]};
  subtract_cross(torque, centre, force);
  const Wide load = norm(force), turn = norm(torque);
  for (int i = 0; i < n; i++) {
    if (!is_present(i)) continue;
    Wide r[3], a[3], f[3];
    for (int j = 0; j < 3; j++) {
      r[j] = c.points[3 * i + j] - centre[j], a[j] = c.normals[3 * i + j], f[j] = c.forces[3 * i + j];
      spread = fmaxl(spread, fabsl(r[j]));
      force[j] -= f[j];
    }
    subtract_cross(torque, r, f);
    const Wide length = norm(a);
    for (int j = 0; j < 3; j++) a[j] /= length, torque[j] -= c.moments[i] * a[j];
    const Wide along = f[0] * a[0] + f[1] * a[1] + f[2] * a[2], mu = c.friction[i], slack = 1e-10L * total;
    const Wide across[3] = {f[0] - along * a[0], f[1] - along * a[1], f[2] - along * a[2]};
    const Wide spin = c.moments[i] == 0 ? 0 : mu * c.moments[i] / c.torsion[i];
    if (!(along >= -slack && hypotl(norm(across), spin) <= mu * along + slack * (1 + mu))) return false;
    if (p.normal_min != nullptr && !(along >= c.low[i] - 1e-9L * c.low[i] - slack)) return false;
    if (p.normal_max != nullptr && !(along <= c.high[i] + 1e-9L * c.high[i] + slack)) return false;
  }
  // Rounding of points far from the origin moves their levers. Contacts that coincide but for it have no lever of their
  // own: a torque of 1e-9 of the load at the frame's distance, the tolerance `range`, counts as rounding of the data.
  const Wide lever = spread <= 1e-13L * distance ? 1e-3L * distance : fmaxl(spread, 1e-9L * distance);
  return norm(force) <= 1e-6L * (load + total + turn / fmaxl(lever, 1e-300L)) &&
         norm(torque) <= 1e-5L * (turn + lever * (total + load) + moments);
}

int main(int, char** arguments) {
  const long count = atol(arguments[1]);
  std::mt19937_64 generator(atol(arguments[2]));
  long verdicts[8] = {}, refuted = 0;
  for (long i = 0; i < count; i++) {
    Case c;
    draw(generator, c);
    jaxgrasp_answer answer;
    const int verdict = jaxgrasp_solve_one_grasp(&c.problem, c.forces.data(), c.moments.data(), &answer);
    if (verdict < 0 || verdict > 7 || verdict != answer.verdict) return 2;
    verdicts[verdict]++;
    if ((verdict <= 1 || verdict == 7) && !is_allowed(c)) {
      refuted++;
      std::fprintf(stderr, "problem %ld of seed %s: verdict %d, residual %g\n", i, arguments[2], verdict, answer.residual);
    }
  }
  for (long number : verdicts) std::printf("%ld ", number);
  std::printf("\n");
  return refuted > 0;
}
