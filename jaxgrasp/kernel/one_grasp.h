// The constrained optimum of one grasp, without JAX: C++17, no dependency, no allocation, no exception, reentrant.
//
//     jaxgrasp::Problem<double> problem;            // pointers to the data of one grasp
//     jaxgrasp::Solution<double, 20> solution;      // at most 20 contacts
//     jaxgrasp::solve(problem, solution);
//
// It takes the steps of the JAX solver (jaxgrasp/solver/phases.py), for one problem at a time, and judges by the same
// tolerances: scaling about the weighted centroid, closed form (eqs. 11 and 15), cone check, Newton's method on the
// dual, the robust phase with its proximal term, the proof of infeasibility, and the residual. docs/mathematics.md
// derives the formulas, ARCHITECTURE.md explains the terms. Torque limits and guides are left to the JAX solver.
// What it cannot decide comes back as NOT_CONVERGED: no answer is called optimal or infeasible without its check.
// In single precision a proof of infeasibility reaches less far: `force_bound` may be only 20 times the load.
//
// Compile with -O3 -march=native -fno-math-errno. Options that give up NaN or rounding (-ffast-math) are refused.
#ifndef JAXGRASP_KERNEL_ONE_GRASP_H
#define JAXGRASP_KERNEL_ONE_GRASP_H

#include "lanes.h"
#include "platform.h"
#include "tolerances.h"

#ifdef __FAST_MATH__
#error "jaxgrasp/kernel needs NaN, infinities and rounding as IEEE 754 has them: compile without -ffast-math"
#endif
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wpsabi"  // Vectors never cross a call: every function that takes one is inlined.
#endif

namespace jaxgrasp {

// The codes of jaxgrasp.Verdict, stable in files. OUTSIDE_CONES is a verdict on the closed form only.
enum Verdict : int {
  CLOSED_FORM_OPTIMAL = 0,
  OPTIMAL = 1,
  OUTSIDE_CONES = 2,
  INFEASIBLE = 3,
  NO_CONTACTS = 4,
  NOT_CONVERGED = 5,
  INVALID_DATA = 6,
  FEASIBLE = 7,
};

// The codes of jaxgrasp.Route: the phase that answered.
enum Route : int { CLOSED_FORM = 0, NEWTON = 1, ROBUST = 2 };

// One grasp and its wrench, in SI units about any frame's origin; arrays by contact, x y z of a vector together.
template <class Real> struct Problem {
  int n_contacts = 0;
  const Real* points = nullptr;      // [3 n] [m]
  const Real* normals = nullptr;     // [3 n] into the object; of any length but zero
  const Real* friction = nullptr;    // [n]
  const Real* squeeze = nullptr;     // [n] intended normal forces s [N]
  const Real* wrench = nullptr;      // [6] what the contacts must exert: force [N], torque [N.m]
  const Real* weights = nullptr;     // [n] sharing weights k; null for the squeeze (method B). Ones are method A
  const Real* present = nullptr;     // [n] 1 or 0 for an absent contact, which carries nothing; null: all present
  const Real* torsion = nullptr;     // [n] torsional friction gamma [m] of soft fingers; null: all contacts are hard
  const Real* normal_min = nullptr;  // [n] bounds of the normal forces [N]; null where there are none
  const Real* normal_max = nullptr;  // [n] may be infinite
  const Real* start = nullptr;       // [6] multiplier of a problem close by, from which Newton's method starts; or null
};

// The answer. `verdict` says what the forces are worth; of INFEASIBLE and NOT_CONVERGED they do not balance the wrench.
template <class Real, int MaxContacts> struct Solution {
  Real forces[3 * MaxContacts];  // what the hand exerts on the object [N]
  Real moments[MaxContacts];     // of soft fingers about their normals [N.m]; else 0
  Real normal_multiplier[MaxContacts];  // of the bounds of normal forces: > 0 at upper, < 0 at lower ones; else 0
  Real multiplier[6];            // of G f = w, about the frame's origin
  Real certificate[6];           // of INFEASIBLE and NO_CONTACTS: the twist d with w.d > 0 that no contact resists
  Real residual;                 // |w - G f| relative to the load
  Real objective;                // sum of |f - s a|^2 / 2k; of NOT_CONVERGED a lower bound
  Real force_bound;              // total normal force that the certificate proves to be needed [N]
  int verdict, route, steps, rank;
};

// Solves one problem. `Soft` and `Bounded` say whether torsion and bounds of normal forces are compiled in; the
// function below chooses them by the data.
template <class Real, int MaxContacts, bool Soft, bool Bounded> class GraspSolver {
 protected:
  using V = Lanes<Real>;
  using M = Mask<Real>;
  using Tol = Tolerances<Real>;
  static constexpr int W = JAXGRASP_LANES;
  static constexpr int BLOCKS = (MaxContacts + W - 1) / W;
  static constexpr int D = Soft ? 4 : 3;  // Components of a contact vector: the fourth is the spin.
  static constexpr int E = D * (D + 1) / 2;
  static constexpr Real EPS = math::Limits<Real>::epsilon;
  static constexpr Real TINY = math::Limits<Real>::smallest;
  static constexpr Real INF = math::Limits<Real>::infinity;
  static constexpr bool IS_DOUBLE = sizeof(Real) == 8;

  // Constants of the JAX solver, with its names: newton.py, proximal.py, optimality.py, infeasibility.py,
  // refinement.py.
  static constexpr Real ARMIJO = Real(1e-4), SHORTEST_STEP = Real(1e-10);
  static constexpr Real DAMPING = Real(0.01), LARGEST_DAMPING = Real(0.1);
  static constexpr Real FIRST_STRENGTH = Real(1e-2), NEAR_STRENGTH = Real(1e-4);
  static constexpr int STEPS_PER_STAGE = 40, LONG_STEPS_PER_STAGE = 300;
  static constexpr Real LONG_MIN_PROXIMAL_WEIGHT = Real(1e-22);
  static constexpr Real LOOSE_FACTOR = 16, BEYOND = Real(0.5), VERIFIER_ROUNDING = 8, ENOUGH = Real(0.25);
  static constexpr int TURNS = 2, REFINING_STEPS = 4, CORRECTIONS = 3;
  static constexpr Real LEAST_DAMPING = Real(1e-20);

  // ---- Data -------------------------------------------------------------------------------------

  struct Contacts {
    V point[BLOCKS][3], normal[BLOCKS][3], friction[BLOCKS], squeeze[BLOCKS], weight[BLOCKS];
    V spin_radius[Soft ? BLOCKS : 1];  // gamma / mu: moment for each unit of the spin component
    V normal_min[Bounded ? BLOCKS : 1], normal_max[Bounded ? BLOCKS : 1];
    Real force[3], torque[3];
  };

  struct Scaling {
    Real first[3], correction[3];  // The centre is their sum: a second mean mends the rounding of the first.
    Real centre[3];
    Real length, weight_sum, force_unit, unweighted_radius;
    bool is_sound, is_turned;
    Real axes[3][3];
  };

  // G W G^T over the angular coordinates; it is the identity over the linear ones.
  struct Metric {
    Real inertia[6];
    Real lower[3], diagonal[3];
  };

  struct ScaledProblem {
    Contacts data;
    Scaling scaling;
    Real scales[3];  // Scales of the angular coordinates; 0 for an axis about which no contact can turn the object.
    Metric metric;
    Real required[6];   // The wrench w in the coordinates.
    Real no_force_cost;  // Objective of zero forces, the scale of a duality gap.
    bool is_ill_conditioned;
  };

  struct Forces {
    V at[BLOCKS][D];
  };

  int n_ = 0, blocks_ = 0;
  Contacts user_;

  // ---- Small vectors ----------------------------------------------------------------------------

  template <class T> static JAXGRASP_INLINE void cross(const T a[3], const T b[3], T out[3]) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
  }
  // v + omega x r, of one twist and the points of a block.
  static JAXGRASP_INLINE void point_velocity(const Real linear[3], const Real angular[3], const V r[3], V out[3]) {
    out[0] = linear[0] + (angular[1] * r[2] - angular[2] * r[1]);
    out[1] = linear[1] + (angular[2] * r[0] - angular[0] * r[2]);
    out[2] = linear[2] + (angular[0] * r[1] - angular[1] * r[0]);
  }
  static JAXGRASP_INLINE V dot3(const V a[3], const V b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  static JAXGRASP_INLINE V dot(const V a[D], const V b[D]) {
    V total = dot3(a, b);
    if constexpr (Soft) total += a[3] * b[3];
    return total;
  }
  static JAXGRASP_INLINE V zero() { return V{}; }
  static JAXGRASP_INLINE V constant(Real x) { return all_lanes<Real>(x); }
  static JAXGRASP_INLINE V safe_divide(V a, V b) {
    M nonzero = b != Real(0);
    return nonzero ? a / (nonzero ? b : constant(1)) : zero();
  }
  static Real safe_divide_one(Real a, Real b) { return b != 0 ? a / b : Real(0); }
  static Real dot6(const Real a[6], const Real b[6]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5];
  }
  static Real norm3(const Real a[3]) { return math::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }
  static Real norm1(const Real a[3]) { return math::fabs(a[0]) + math::fabs(a[1]) + math::fabs(a[2]); }
  static Real norm6(const Real a[6]) { return math::sqrt(dot6(a, a)); }
  static Real at_most(Real a, Real b) { return b < a ? b : a; }
  static Real at_least(Real a, Real b) { return b > a ? b : a; }

  // t - a x b where the difference may be far smaller than its terms: products and sums with their errors (Dekker 1971,
  // Knuth's two-sum; problem/scaling.py), each product's error by a fused multiply-add.
  JAXGRASP_OUTLINE
  static void minus_cross(const Real t[3], const Real a[3], const Real b[3], Real out[3]) {
    for (int i = 0; i < 3; i++) {
      int j = (i + 1) % 3, k = (i + 2) % 3;
      const Real p = math::product(a[j], b[k]), m = math::product(a[k], b[j]);
      Real p_error = math::fma(a[j], b[k], -p), m_error = math::fma(a[k], b[j], -m);
      Real first_error, second_error;
      Real first = two_sum(t[i], -p, first_error);
      Real second = two_sum(first, m, second_error);
      out[i] = second + (first_error + second_error + (m_error - p_error));
    }
  }
  static Real two_sum(Real a, Real b, Real& error) {
    Real total = a + b, of_b = total - a;
    error = (a - (total - of_b)) + (b - of_b);
    return total;
  }

  // ---- Small symmetric systems: A = L D L^T without pivoting (numerics/ldl.py) ------------------

  // Entry (i, j) of a lower triangle stored row by row.
  static constexpr int entry(int i, int j) { return i * (i + 1) / 2 + j; }

  // Solve A x = right; the matrix is overwritten by its factors.
  static JAXGRASP_INLINE void solve_six(Real a[21], const Real right[6], Real x[6]) {
    Real inverse[6];
    for (int i = 0; i < 6; i++) {
      Real scaled[6];  // Entries of L times D.
      for (int j = 0; j < i; j++) {
        Real total = a[entry(i, j)];
        for (int m = 0; m < j; m++) total -= scaled[m] * a[entry(j, m)];
        scaled[j] = total;
      }
      Real diagonal = a[entry(i, i)], rest = right[i];
      for (int j = 0; j < i; j++) {
        a[entry(i, j)] = scaled[j] * inverse[j];
        diagonal -= scaled[j] * a[entry(i, j)];
        rest -= a[entry(i, j)] * x[j];
      }
      inverse[i] = 1 / diagonal;
      x[i] = rest;
    }
    for (int i = 5; i >= 0; i--) {
      x[i] *= inverse[i];
      for (int j = i + 1; j < 6; j++) x[i] -= a[entry(j, i)] * x[j];
    }
  }
  static void factor_three(Metric& metric) {
    const Real* a = metric.inertia;
    Real *l = metric.lower, *d = metric.diagonal;
    d[0] = a[0];
    l[0] = a[1] / d[0];
    d[1] = a[2] - a[1] * l[0];
    l[1] = a[3] / d[0];
    Real scaled = a[4] - a[3] * l[0];
    l[2] = scaled / d[1];
    d[2] = a[5] - a[3] * l[1] - scaled * l[2];
  }
  static void solve_three(const Metric& metric, const Real right[3], Real x[3]) {
    const Real *l = metric.lower, *d = metric.diagonal;
    Real y0 = right[0], y1 = right[1] - l[0] * y0, y2 = right[2] - l[1] * y0 - l[2] * y1;
    x[2] = y2 / d[2];
    x[1] = y1 / d[1] - l[2] * x[2];
    x[0] = y0 / d[0] - l[0] * x[1] - l[1] * x[2];
  }
  // |g|^2 = g.(G W G^T)^-1 g
  static Real squared_norm(const Metric& metric, const Real g[6]) {
    Real x[3];
    solve_three(metric, g + 3, x);
    return g[0] * g[0] + g[1] * g[1] + g[2] * g[2] + g[3] * x[0] + g[4] * x[1] + g[5] * x[2];
  }
  static void add_damping(Real curvature[21], const Metric& metric, Real damping) {
    for (int i = 0; i < 3; i++) {
      curvature[entry(i, i)] += damping;
      for (int j = 0; j <= i; j++) curvature[entry(3 + i, 3 + j)] += damping * metric.inertia[entry(i, j)];
    }
  }

  // Orthonormal eigenvectors of a 3x3 matrix by Jacobi's rotations, in no order.
  JAXGRASP_OUTLINE
  static void principal_axes(const Real inertia[6], Real axes[3][3]) {
    constexpr int SWEEPS = 5;
    Real a[3][3];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) {
        a[i][j] = inertia[i >= j ? entry(i, j) : entry(j, i)];
        axes[i][j] = i == j;
      }
    for (int turn = 0; turn < 3 * SWEEPS; turn++) {
      int p = turn % 3, q = (turn + 1) % 3;
      // tan of the smaller angle: off / (half_gap + sign(half_gap) sqrt(half_gap^2 + off^2))
      Real half_gap = (a[q][q] - a[p][p]) / 2, off = a[p][q];
      Real reach = math::fabs(half_gap) + math::sqrt(half_gap * half_gap + off * off);
      Real tangent = safe_divide_one(half_gap < 0 ? -off : off, reach);
      Real cosine = 1 / math::sqrt(1 + tangent * tangent), sine = tangent * cosine;
      for (int j = 0; j < 3; j++) {
        Real first = a[p][j], second = a[q][j];
        a[p][j] = cosine * first - sine * second;
        a[q][j] = sine * first + cosine * second;
        first = axes[p][j], second = axes[q][j];
        axes[p][j] = cosine * first - sine * second;
        axes[q][j] = sine * first + cosine * second;
      }
      for (int i = 0; i < 3; i++) {
        Real first = a[i][p], second = a[i][q];
        a[i][p] = cosine * first - sine * second;
        a[i][q] = sine * first + cosine * second;
      }
    }
  }
  static void rotate(const Real axes[3][3], const Real a[3], Real out[3]) {
    for (int i = 0; i < 3; i++) out[i] = axes[i][0] * a[0] + axes[i][1] * a[1] + axes[i][2] * a[2];
  }
  static void rotate_back(const Real axes[3][3], const Real a[3], Real out[3]) {
    for (int i = 0; i < 3; i++) out[i] = axes[0][i] * a[0] + axes[1][i] * a[1] + axes[2][i] * a[2];
  }
  static JAXGRASP_INLINE void rotate_lanes(const Real axes[3][3], V a[3]) {
    V x = a[0], y = a[1], z = a[2];
    for (int i = 0; i < 3; i++) a[i] = axes[i][0] * x + axes[i][1] * y + axes[i][2] * z;
  }

  // ---- Reading the data (problem/batch_last.py) -------------------------------------------------

  // Copy the data; absent contacts become contacts that carry nothing. Return whether all data can be used.
  JAXGRASP_OUTLINE
  bool read(const Problem<Real>& p) {
    n_ = p.n_contacts;
    blocks_ = (n_ + W - 1) / W;
    Contacts& c = user_;
    for (int b = 0; b < blocks_; b++) {
      for (int i = 0; i < 3; i++) c.point[b][i] = c.normal[b][i] = zero();
      c.friction[b] = c.squeeze[b] = c.weight[b] = zero();
      if constexpr (Soft) c.spin_radius[b] = zero();
      if constexpr (Bounded) c.normal_min[b] = zero(), c.normal_max[b] = constant(INF);
    }
    bool valid = true;
    Real load = 0;
    for (int i = 0; i < 6; i++) load += math::fabs(p.wrench[i]);
    valid = load <= Tol::largest;
    for (int i = 0; i < n_; i++) valid &= read_contact(p, i);
    for (int i = 0; i < 3; i++) c.force[i] = p.wrench[i], c.torque[i] = p.wrench[3 + i];
    return valid;
  }
  bool read_contact(const Problem<Real>& p, int i) {
    if (p.present != nullptr) {
      if (math::isnan(p.present[i])) return false;
      if (!(p.present[i] > Real(0.5))) return true;
    }
    const Real *r = p.points + 3 * i, *a = p.normals + 3 * i;
    Real mu = p.friction[i], s = p.squeeze[i], k = p.weights != nullptr ? p.weights[i] : s;
    Real a2 = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
    // One sum meets a NaN, or what is too large to be squared, in any of its terms.
    Real size = norm1(r) + a2 + math::fabs(mu) + math::fabs(s) + math::fabs(k);
    // The square of a normal keeps its digits only above this.
    bool usable = a2 >= TINY / EPS && mu >= 0 && s >= 0 && k >= 0 && !math::is_subnormal(k);
    Real gamma = 0, low = 0, high = INF;
    if constexpr (Soft) {
      gamma = p.torsion[i];
      size += math::fabs(gamma);
      // The spin radius gamma / mu is squared too.
      usable = usable && gamma >= 0 && (mu == 0 || gamma <= Tol::largest * mu) && !math::is_subnormal(mu);
    }
    if constexpr (Bounded) {
      low = p.normal_min != nullptr ? p.normal_min[i] : Real(0);
      high = p.normal_max != nullptr ? p.normal_max[i] : INF;
      size += math::fabs(low);
      usable = usable && low >= 0 && high >= low;
    }
    if (!(usable && size <= Tol::largest)) return false;
    // A contact that cannot move holds its squeeze, within the bounds.
    if constexpr (Bounded)
      if (!(k > 0)) s = at_most(at_least(s, low), high);
    int b = i / W, l = i % W;
    Real inverse = 1 / math::sqrt(a2);
    for (int j = 0; j < 3; j++) {
      set_lane<Real>(user_.point[b][j], l, r[j]);
      set_lane<Real>(user_.normal[b][j], l, inverse * a[j]);
    }
    set_lane<Real>(user_.friction[b], l, mu);
    set_lane<Real>(user_.squeeze[b], l, s);
    set_lane<Real>(user_.weight[b], l, k);
    if constexpr (Soft) set_lane<Real>(user_.spin_radius[b], l, safe_divide_one(gamma, mu));
    if constexpr (Bounded) {
      set_lane<Real>(user_.normal_min[b], l, low);
      set_lane<Real>(user_.normal_max[b], l, high);
    }
    return true;
  }

  // ---- Scaling (problem/scaling.py, coordinates.py, scaled_problem.py) --------------------------

  enum class Axes { SUITABLE, PRINCIPAL };

  // Bring the user's data to coordinates of order one: about the weighted centroid, lengths by the weighted radius,
  // weights by their sum, forces by the load. `with_squeeze` false poses the feasibility problem: no squeeze, equal
  // weights.
  JAXGRASP_OUTLINE
  void scale(Axes axes, bool with_squeeze, ScaledProblem& out) const {
    Contacts& c = out.data;
    Scaling& s = out.scaling;
    V total = zero();
    for (int b = 0; b < blocks_; b++) {
      M changed = user_.weight[b] > (with_squeeze ? INF : Real(0));
      c.weight[b] = changed ? constant(1) : user_.weight[b];
      c.squeeze[b] = changed ? zero() : user_.squeeze[b];
      total += c.weight[b];
    }
    s.weight_sum = sum<Real>(total);
    // Centre: the weighted mean of the points, twice.
    V mean[3] = {zero(), zero(), zero()};
    for (int b = 0; b < blocks_; b++) {
      c.weight[b] = s.weight_sum > 0 ? c.weight[b] / s.weight_sum : c.weight[b];
      for (int i = 0; i < 3; i++) mean[i] += c.weight[b] * user_.point[b][i];
    }
    for (int i = 0; i < 3; i++) s.first[i] = sum<Real>(mean[i]), mean[i] = zero();
    for (int b = 0; b < blocks_; b++)
      for (int i = 0; i < 3; i++) {
        c.point[b][i] = user_.point[b][i] - s.first[i];
        mean[i] += c.weight[b] * c.point[b][i];
      }
    for (int i = 0; i < 3; i++) s.correction[i] = sum<Real>(mean[i]), s.centre[i] = s.first[i] + s.correction[i];
    V square = zero(), distance_sum = zero(), plain_square = zero(), count = zero(), subnormal = zero();
    for (int b = 0; b < blocks_; b++) {
      const V k = c.weight[b];
      for (int i = 0; i < 3; i++) c.point[b][i] -= s.correction[i];
      V size2 = dot3(c.point[b], c.point[b]);
      V size = magnitude<Real>(c.point[b][0]) + magnitude<Real>(c.point[b][1]) + magnitude<Real>(c.point[b][2]);
      if constexpr (Soft) size2 += user_.spin_radius[b] * user_.spin_radius[b], size += user_.spin_radius[b];
      M is_adjustable = user_.weight[b] > Real(0), is_lost = is_adjustable & (k < TINY);
      square += k * size2;
      distance_sum += k * size;
      plain_square += is_adjustable ? size2 : zero();
      count += is_adjustable ? constant(1) : zero();
      subnormal += is_lost ? constant(1) : zero();
    }
    s.length = math::sqrt(sum<Real>(square));
    // Contacts that coincide but for rounding have no length of their own.
    Real distance = norm3(s.centre), rounding_distance = Tol::rank * distance, mean_distance = sum<Real>(distance_sum);
    if (!(s.length > rounding_distance)) s.length = rounding_distance > 0 ? distance : Real(1);
    Real radius2 = sum<Real>(plain_square) / (at_least(sum<Real>(count), 1) * (s.length * s.length));
    s.unweighted_radius = math::sqrt(at_least(radius2, 1));
    Real inverse_length = 1 / s.length;
    V squeeze_sum = zero();
    for (int b = 0; b < blocks_; b++) {
      for (int i = 0; i < 3; i++) {
        c.point[b][i] *= inverse_length;
        c.normal[b][i] = user_.normal[b][i];
      }
      c.friction[b] = user_.friction[b];
      if constexpr (Soft) c.spin_radius[b] = user_.spin_radius[b] / s.length;
      squeeze_sum += c.squeeze[b];
    }
    // The torque about the centre.
    Real moved[3], more[3];
    minus_cross(user_.torque, s.first, user_.force, moved);
    cross(s.correction, user_.force, more);
    for (int i = 0; i < 3; i++) c.force[i] = user_.force[i], c.torque[i] = moved[i] - more[i];
    choose_axes(axes, out);
    // Divide by the load.
    Real squeeze = sum<Real>(squeeze_sum);
    Real load = squeeze + norm3(c.force) + norm3(c.torque) / s.length;
    // Numbers whose squares lose their digits or overflow cannot be used.
    s.is_sound = (s.weight_sum == 0 || s.weight_sum >= Tol::smallest) && (load == 0 || load >= Tol::smallest) &&
                 (mean_distance <= rounding_distance || mean_distance >= Tol::smallest) && sum<Real>(subnormal) == 0 &&
                 load <= Tol::largest_load;
    // A wrench whose square vanishes beside the load's would pass for none.
    const Real wrench = norm1(c.force) + norm1(c.torque) / s.length;
    s.is_sound = s.is_sound && (norm1(c.force) + norm1(c.torque) == 0 ||
                                (wrench >= 16 * math::sqrt(TINY) * load && load > 0));
    s.force_unit = load > 0 ? load : Real(1);
    Real torque_unit = s.force_unit * s.length;
    for (int i = 0; i < 3; i++) c.force[i] /= s.force_unit, c.torque[i] /= torque_unit;
    V cost = zero();
    for (int b = 0; b < blocks_; b++) {
      c.squeeze[b] /= s.force_unit;
      cost += safe_divide(c.squeeze[b] * c.squeeze[b], 2 * c.weight[b]);
      if constexpr (Bounded) {
        c.normal_min[b] = user_.normal_min[b] / s.force_unit;
        c.normal_max[b] = user_.normal_max[b] / s.force_unit;
      }
    }
    out.no_force_cost = sum<Real>(cost);
    for (int i = 0; i < 3; i++) out.required[i] = c.force[i], out.required[3 + i] = out.scales[i] * c.torque[i];
  }

  // Keep the user's axes where G W G^T is well-conditioned there, else turn to its principal axes and whiten it by the
  // scales of the angular coordinates: points that are tiny in one direction keep their own digits.
  JAXGRASP_OUTLINE
  void choose_axes(Axes axes, ScaledProblem& p) const {
    Contacts& c = p.data;
    Scaling& s = p.scaling;
    Metric& metric = p.metric;
    inertia_of(c, metric.inertia);
    if (!(s.weight_sum > 0)) set_identity(metric.inertia);
    factor_three(metric);
    const Real* d = metric.diagonal;
    // `not >=` rather than `<`, so that a NaN out of a zero pivot counts as ill.
    p.is_ill_conditioned = !(d[0] >= Tol::pivot && d[1] >= Tol::pivot && d[2] >= Tol::pivot);
    s.is_turned = axes == Axes::PRINCIPAL || p.is_ill_conditioned;
    for (int i = 0; i < 3; i++) p.scales[i] = 1;
    if (!s.is_turned) return;
    principal_axes(metric.inertia, s.axes);
    Real turned[3];
    for (int b = 0; b < blocks_; b++) rotate_lanes(s.axes, c.point[b]), rotate_lanes(s.axes, c.normal[b]);
    rotate(s.axes, c.force, turned);
    for (int i = 0; i < 3; i++) c.force[i] = turned[i];
    rotate(s.axes, c.torque, turned);
    for (int i = 0; i < 3; i++) c.torque[i] = turned[i];
    inertia_of(c, metric.inertia);
    if (!(s.weight_sum > 0)) set_identity(metric.inertia);
    Real growth = rounding_growth(s), cut = Tol::rank * growth * (Tol::rank * growth);
    for (int i = 0; i < 3; i++) {
      Real spread = metric.inertia[entry(i, i)];
      p.scales[i] = spread > cut ? 1 / math::sqrt(spread) : Real(0);
    }
    for (int i = 0; i < 3; i++)
      for (int j = 0; j <= i; j++) metric.inertia[entry(i, j)] *= p.scales[i] * p.scales[j];
    for (int i = 0; i < 3; i++)
      if (!(p.scales[i] > 0)) metric.inertia[entry(i, i)] = 1;
    factor_three(metric);
  }
  static void set_identity(Real inertia[6]) {
    for (int i = 0; i < 6; i++) inertia[i] = i == 0 || i == 2 || i == 5;
  }
  // The factor by which the frame's distance multiplies the rounding of points.
  static Real rounding_growth(const Scaling& s) { return 1 + norm3(s.centre) / s.length; }

  // Torque block of G W G^T: sum of k (|r|^2 I - r r^T), for soft fingers + k l^2 a a^T.
  void inertia_of(const Contacts& c, Real inertia[6]) const {
    V xx = zero(), yy = zero(), zz = zero(), xy = zero(), xz = zero(), yz = zero();
    for (int b = 0; b < blocks_; b++) {
      const V *r = c.point[b], x = c.weight[b] * r[0], y = c.weight[b] * r[1], z = c.weight[b] * r[2];
      xx += x * r[0], yy += y * r[1], zz += z * r[2];
      xy += x * r[1], xz += x * r[2], yz += y * r[2];
    }
    inertia[0] = sum<Real>(yy) + sum<Real>(zz);
    inertia[1] = -sum<Real>(xy);
    inertia[2] = sum<Real>(xx) + sum<Real>(zz);
    inertia[3] = -sum<Real>(xz);
    inertia[4] = -sum<Real>(yz);
    inertia[5] = sum<Real>(xx) + sum<Real>(yy);
    if constexpr (Soft)
      for (int b = 0; b < blocks_; b++) {
        const V *a = c.normal[b], k = c.weight[b] * c.spin_radius[b] * c.spin_radius[b];
        for (int i = 0; i < 3; i++)
          for (int j = 0; j <= i; j++) inertia[entry(i, j)] += sum<Real>(k * a[i] * a[j]);
      }
  }

  // ---- One contact: the friction cone (problem/friction_cone.py) --------------------------------

  struct Split {
    V along, size, tangent[D], edge_normal_force;
    M inside, polar, on_bound;
    V bound_normal_force;
  };

  // Split a vector into its normal and tangential parts, and say in which region of the cone it lies.
  static JAXGRASP_INLINE void decompose(const V u[D], const Contacts& c, int b, bool bounds, Split& split) {
    const V* a = c.normal[b];
    const V mu = c.friction[b];
    V along = dot3(u, a), across[D];
    for (int i = 0; i < 3; i++) across[i] = u[i] - along * a[i];
    if constexpr (Soft) across[3] = u[3];
    V square = dot(across, across), size = square_root<Real>(square);
    V inverse = size > Real(0) ? Real(1) / (size > Real(0) ? size : constant(1)) : zero();
    for (int i = 0; i < D; i++) split.tangent[i] = across[i] * inverse;
    if constexpr (Bounded) {
      // Beside a squeeze far beyond a bound, rounding leaves a normal part that would move forces past the bound.
      V rest = dot3(split.tangent, a);
      for (int i = 0; i < 3; i++) split.tangent[i] -= rest * a[i];
    }
    split.along = along, split.size = size;
    // The polar cone first: without friction a pull straight along the normal would pass for inside.
    split.polar = mu * size < -along;
    V limit = mu * along;
    split.inside = (along >= Real(0)) & (square <= limit * limit) & (mu > Real(0));
    // Normal part of the projection on the edge: (u_a + mu |u_t|) / (1 + mu^2)
    V rise = along + mu * size;
    split.edge_normal_force = (rise < Real(0) ? zero() : rise) / (1 + mu * mu);
    if constexpr (Bounded) {
      V free = split.inside ? along : (split.polar ? zero() : split.edge_normal_force);
      V low = c.normal_min[b], high = c.normal_max[b];
      V bound = free < low ? low : free;
      bound = bound > high ? high : bound;
      split.on_bound = bounds ? bound != free : free != free;
      split.bound_normal_force = bound;
      split.inside = split.inside & !split.on_bound;
      split.polar = split.polar & !split.on_bound;
    }
  }

  // The closest allowed force.
  static JAXGRASP_INLINE void project(const V u[D], const Contacts& c, int b, const Split& split, V out[D]) {
    const V *a = c.normal[b], mu = c.friction[b];
    // p (a + mu u_t / |u_t|)
    V p = split.polar ? zero() : split.edge_normal_force, across = p * mu;
    for (int i = 0; i < D; i++) {
      V on_edge = i < 3 ? p * a[i] + across * split.tangent[i] : across * split.tangent[i];
      out[i] = split.inside ? u[i] : on_edge;
    }
    if constexpr (Bounded) {
      V height = split.bound_normal_force, rim = mu * height;
      V reach = split.size < rim ? split.size : rim;
      for (int i = 0; i < D; i++) {
        V on_disc = i < 3 ? height * a[i] + reach * split.tangent[i] : reach * split.tangent[i];
        out[i] = split.on_bound ? on_disc : out[i];
      }
    }
  }

  // An element of the projection's generalised Jacobian, a lower triangle: on the edge
  // e e^T / (1 + mu^2) + (mu p / |u_t|) (I - a a^T - t t^T), with e = a + mu t.
  static JAXGRASP_INLINE void derivative(const Contacts& c, int b, const Split& split, V out[E]) {
    const V *a = c.normal[b], *t = split.tangent, mu = c.friction[b];
    M off_edge = split.inside | split.polar;
    V turning = off_edge ? zero() : safe_divide(mu * split.edge_normal_force, split.size);
    V along_edge = off_edge ? zero() : Real(1) / (1 + mu * mu);
    V isotropic = split.inside ? constant(1) : turning;
    V edge[D], normal[D];
    for (int i = 0; i < D; i++) {
      normal[i] = i < 3 ? a[i] : zero();
      edge[i] = normal[i] + mu * t[i];
    }
    for (int i = 0; i < D; i++) {
      for (int j = 0; j <= i; j++)
        out[entry(i, j)] = along_edge * edge[i] * edge[j] - turning * (normal[i] * normal[j] + t[i] * t[j]);
      out[entry(i, i)] += isotropic;
    }
    if constexpr (Bounded) {
      // On a disc: I - a a^T inside, (mu p / |u_t|) (I - a a^T - t t^T) at its rim.
      V rim = mu * split.bound_normal_force;
      M flat = split.size <= rim;
      V turn = flat ? zero() : safe_divide(rim, split.size);
      V tangential = flat ? constant(1) : turn;
      for (int i = 0; i < D; i++)
        for (int j = 0; j <= i; j++) {
          V held = -tangential * normal[i] * normal[j] - turn * t[i] * t[j];
          if (i == j) held += tangential;
          out[entry(i, j)] = split.on_bound ? held : out[entry(i, j)];
        }
    }
  }

  // Whether forces are allowed, rounding aside.
  bool contains(const ScaledProblem& p, const Forces& forces) const {
    constexpr Real slack = 8 * EPS;
    for (int b = 0; b < blocks_; b++) {
      const V *f = forces.at[b], *a = p.data.normal[b], mu = p.data.friction[b];
      V along = dot3(f, a), across[D];
      for (int i = 0; i < 3; i++) across[i] = f[i] - along * a[i];
      if constexpr (Soft) across[3] = f[3];
      V limit = mu * along + slack * (1 + mu) * magnitude<Real>(along);
      M allowed = (along >= Real(0)) & (dot(across, across) <= limit * limit);
      if constexpr (Bounded)
        allowed = allowed & (along >= (1 - slack) * p.data.normal_min[b]) &
                  (along <= (1 + slack) * p.data.normal_max[b]);
      if (!all_true<Real>(allowed)) return false;
    }
    return true;
  }

  // ---- The dual (solver/dual.py) ----------------------------------------------------------------

  static JAXGRASP_INLINE void velocity_at(const ScaledProblem& p, int b, const Real linear[3], const Real angular[3],
                                          V out[D]) {
    point_velocity(linear, angular, p.data.point[b], out);
    // A soft finger's spin is gamma omega.a_i.
    if constexpr (Soft) {
      const V* a = p.data.normal[b];
      out[3] = p.data.spin_radius[b] * (angular[0] * a[0] + angular[1] * a[1] + angular[2] * a[2]);
    }
  }
  // The target s a + k G_i^T x, whose projection is the candidate force.
  static JAXGRASP_INLINE void target_at(const ScaledProblem& p, int b, const V velocity[D], V out[D]) {
    const V *a = p.data.normal[b], s = p.data.squeeze[b], k = p.data.weight[b];
    for (int i = 0; i < D; i++) out[i] = i < 3 ? s * a[i] + k * velocity[i] : k * velocity[i];
  }
  // Velocity and target of the contacts of a block, and the region of the cone in which the target lies.
  static JAXGRASP_INLINE void split_target(const ScaledProblem& p, int b, const Real linear[3], const Real angular[3],
                                           V velocity[D], V target[D], Split& split) {
    velocity_at(p, b, linear, angular, velocity);
    target_at(p, b, velocity, target);
    decompose(target, p.data, b, true, split);
  }
  static void twist_of(const ScaledProblem& p, const Real x[6], Real linear[3], Real angular[3]) {
    for (int i = 0; i < 3; i++) linear[i] = x[i], angular[i] = p.scales[i] * x[3 + i];
  }
  // |f - s a|^2 / 2k of each contact; 0 where k is 0.
  static JAXGRASP_INLINE V deviation_cost(const Contacts& c, int b, const V f[D]) {
    V deviation[D];
    for (int i = 0; i < 3; i++) deviation[i] = f[i] - c.squeeze[b] * c.normal[b][i];
    if constexpr (Soft) deviation[3] = f[3];
    return safe_divide(dot(deviation, deviation), 2 * c.weight[b]);
  }
  // Add each contact's part of the wrench: force f_i, then torque r_i x f_i.
  static JAXGRASP_INLINE void add_wrench(const Contacts& c, int b, const V f[D], V wrench[6]) {
    V torque[3];
    cross<V>(c.point[b], f, torque);
    for (int i = 0; i < 3; i++) wrench[i] += f[i];
    if constexpr (Soft)
      for (int i = 0; i < 3; i++) torque[i] += c.spin_radius[b] * f[3] * c.normal[b][i];
    for (int i = 0; i < 3; i++) wrench[3 + i] += torque[i];
  }
  // Add k G_i J G_i^T of each contact, a lower triangle of 21 entries.
  static JAXGRASP_INLINE void add_curvature(const Contacts& c, int b, const V jacobian[E], V h[21]) {
    const V *r = c.point[b], k = c.weight[b];
    V d[3][3], mixed[3][3], angular[3][3];
    for (int i = 0; i < 3; i++)
      for (int j = 0; j <= i; j++) d[i][j] = d[j][i] = k * jacobian[entry(i, j)];
    for (int j = 0; j < 3; j++) {
      V column[3] = {d[0][j], d[1][j], d[2][j]}, turned[3];
      cross<V>(r, column, turned);
      for (int i = 0; i < 3; i++) mixed[i][j] = turned[i];
    }
    V spin[3], turned[3];
    if constexpr (Soft) {
      V last[3] = {k * jacobian[6], k * jacobian[7], k * jacobian[8]}, diagonal = k * jacobian[9];
      cross<V>(r, last, turned);
      for (int i = 0; i < 3; i++) {
        spin[i] = c.spin_radius[b] * c.normal[b][i];
        turned[i] += diagonal * spin[i];
        for (int j = 0; j < 3; j++) mixed[i][j] += spin[i] * last[j];
      }
    }
    for (int i = 0; i < 3; i++) {
      cross<V>(r, mixed[i], angular[i]);
      if constexpr (Soft)
        for (int j = 0; j < 3; j++) angular[i][j] += turned[i] * spin[j];
    }
    for (int i = 0; i < 3; i++)
      for (int j = 0; j <= i; j++) {
        h[entry(i, j)] += d[i][j];
        h[entry(3 + i, 3 + j)] += angular[i][j];
      }
    for (int i = 0; i < 3; i++)
      for (int j = 0; j < 3; j++) h[entry(3 + i, j)] += mixed[i][j];
  }
  // The matrix over twists as one over the coordinates.
  static JAXGRASP_INLINE void curvature_of(const ScaledProblem& p, const V h[21], Real out[21]) {
    for (int i = 0; i < 21; i++) out[i] = sum<Real>(h[i]);
    for (int i = 0; i < 3; i++) {
      for (int j = 0; j < 3; j++) out[entry(3 + i, j)] *= p.scales[i];
      for (int j = 0; j <= i; j++) out[entry(3 + i, 3 + j)] *= p.scales[i] * p.scales[j];
    }
  }
  // w - G f in the coordinates.
  static JAXGRASP_INLINE void unbalanced(const ScaledProblem& p, const V wrench[6], Real out[6]) {
    for (int i = 0; i < 3; i++) {
      out[i] = p.data.force[i] - sum<Real>(wrench[i]);
      out[3 + i] = p.scales[i] * (p.data.torque[i] - sum<Real>(wrench[3 + i]));
    }
  }

  struct DualEvaluation {
    Real value, gradient[6], curvature[21], total_normal_force;
  };

  // Value w.x + sum of |f - s a|^2 / 2k - v.f, gradient w - G f, and minus the Hessian, sum of k_i G_i D_i G_i^T.
  void evaluate(const ScaledProblem& p, const Real x[6], DualEvaluation& out) const {
    Real linear[3], angular[3];
    twist_of(p, x, linear, angular);
    V cost = zero(), pressed = zero(), wrench[6], h[21];
    for (int i = 0; i < 6; i++) wrench[i] = zero();
    for (int i = 0; i < 21; i++) h[i] = zero();
    for (int b = 0; b < blocks_; b++) {
      V velocity[D], target[D], f[D], jacobian[E];
      Split split;
      split_target(p, b, linear, angular, velocity, target, split);
      project(target, p.data, b, split, f);
      derivative(p.data, b, split, jacobian);
      cost += deviation_cost(p.data, b, f) - dot(velocity, f);
      pressed += dot3(f, p.data.normal[b]);
      add_wrench(p.data, b, f, wrench);
      add_curvature(p.data, b, jacobian, h);
    }
    out.value = dot6(p.required, x) + sum<Real>(cost);
    out.total_normal_force = sum<Real>(pressed);
    unbalanced(p, wrench, out.gradient);
    curvature_of(p, h, out.curvature);
  }

  JAXGRASP_OUTLINE
  void candidate_forces(const ScaledProblem& p, const Real x[6], Forces& out) const {
    Real linear[3], angular[3];
    twist_of(p, x, linear, angular);
    for (int b = 0; b < blocks_; b++) {
      V velocity[D], target[D];
      Split split;
      split_target(p, b, linear, angular, velocity, target, split);
      project(target, p.data, b, split, out.at[b]);
    }
  }

  // ---- Residual and optimality (solver/result.py, optimality.py) --------------------------------

  struct Measurement {
    Real force[3], torque[3];  // w - G f
    Real residual[6];          // the same in the coordinates
    Real relative_residual, objective, total_normal_force;
    bool is_hidden;  // Only rounding of the forces excuses the residual.
  };

  // Measure forces: |w - G f| / max(|w|, c sum of |G_i| |f_i|), in units of the contacts' reach and in the coordinates.
  JAXGRASP_OUTLINE
  void measure(const ScaledProblem& p, const Forces& forces, Measurement& out) const {
    const Real unit = 1 / p.scaling.unweighted_radius;
    V cost = zero(), pressed = zero(), plain_sum = zero(), scaled_sum = zero(), wrench[6];
    for (int i = 0; i < 6; i++) wrench[i] = zero();
    for (int b = 0; b < blocks_; b++) {
      const V *f = forces.at[b], *r = p.data.point[b];
      cost += deviation_cost(p.data, b, f);
      pressed += dot3(f, p.data.normal[b]);
      add_wrench(p.data, b, f, wrench);
      V size2 = dot3(r, r), plain = zero(), scaled = zero();
      for (int i = 0; i < 3; i++) {
        V lever2 = size2 - r[i] * r[i];
        if constexpr (Soft) {
          V spin = p.data.spin_radius[b] * p.data.normal[b][i];
          lever2 += spin * spin;
        }
        plain += unit * unit * lever2;
        scaled += p.scales[i] * p.scales[i] * lever2;
      }
      V size = square_root<Real>(dot(f, f));
      plain_sum += square_root<Real>(1 + (plain > Real(0) ? plain : zero())) * size;
      scaled_sum += square_root<Real>(1 + (scaled > Real(0) ? scaled : zero())) * size;
    }
    out.objective = sum<Real>(cost);
    out.total_normal_force = sum<Real>(pressed);
    for (int i = 0; i < 3; i++) {
      out.force[i] = out.residual[i] = p.data.force[i] - sum<Real>(wrench[i]);
      out.torque[i] = p.data.torque[i] - sum<Real>(wrench[3 + i]);
      out.residual[3 + i] = p.scales[i] * out.torque[i];
    }
    Real plain_scales[3] = {unit, unit, unit};
    bool hidden[2];
    Real by_reach = relative(p, out, plain_scales, sum<Real>(plain_sum), hidden[0]);
    Real by_coordinates = relative(p, out, p.scales, sum<Real>(scaled_sum), hidden[1]);
    // Written so that a NaN is kept.
    out.relative_residual = by_reach >= by_coordinates ? by_reach : by_coordinates;
    if (math::isnan(by_reach)) out.relative_residual = by_reach;
    out.is_hidden = hidden[0] || hidden[1];
    if constexpr (Soft) {
      const Real by_torque = relative_torque(p, forces, out);
      if (!(by_torque <= out.relative_residual)) out.relative_residual = by_torque;
    }
  }
  // The unbalanced torque relative to the torques of forces and moments; the tolerance `torque` corresponds to
  // `balance` here. A spin radius far beyond the spread of the points sets the unit of length, in which all torques of
  // forces would pass for rounding.
  Real relative_torque(const ScaledProblem& p, const Forces& forces, const Measurement& m) const {
    V torques = zero(), sizes = zero();
    for (int b = 0; b < blocks_; b++) {
      const V *f = forces.at[b], *r = p.data.point[b];
      const V size = magnitude<Real>(f[0]) + magnitude<Real>(f[1]) + magnitude<Real>(f[2]);
      const V lever = magnitude<Real>(r[0]) + magnitude<Real>(r[1]) + magnitude<Real>(r[2]);
      sizes += size;
      torques += lever * size + magnitude<Real>(p.data.spin_radius[b] * f[D - 1]);
    }
    // Levers are known to the rounding of the points in the user's frame.
    const Real lever = 64 * EPS * norm3(p.scaling.centre) / p.scaling.length;
    const Real rounding = lever * (norm1(p.data.force) + sum<Real>(sizes)) / Tol::balance;
    const Real all = Tol::torque / Tol::balance * (norm1(p.data.torque) + sum<Real>(torques));
    return safe_divide_one(norm1(m.torque), all + rounding);
  }
  static Real relative(const ScaledProblem& p, const Measurement& m, const Real scales[3], Real force_sum,
                       bool& is_hidden) {
    Real residual[6], load[6];
    // In units of the wrench itself, since the square of one that is far lighter than the squeeze would underflow.
    const Real load_size = norm1(p.data.force) + norm1(p.data.torque), growth = load_size > 0 ? 1 / load_size : Real(1);
    for (int i = 0; i < 3; i++) {
      residual[i] = growth * m.force[i], residual[3 + i] = scales[i] * (growth * m.torque[i]);
      load[i] = growth * p.data.force[i], load[3 + i] = scales[i] * (growth * p.data.torque[i]);
    }
    Real size = norm6(residual), required = norm6(load);
    is_hidden = required > 0 && size > Tol::balance * required;
    Real rounded = Tol::sums / Tol::balance * force_sum * growth;
    // The squares of forces beyond all measure overflow.
    return rounded < INF ? safe_divide_one(size, required >= rounded ? required : rounded) : INF;
  }

  // |g|^2 <= (tolerance (1 + sum of normal forces))^2
  static bool is_small(Real squared_norm, Real total_normal_force, Real tolerance) {
    Real bound = tolerance * (1 + total_normal_force);
    return squared_norm <= bound * bound;
  }
  static Real gap_scale(const ScaledProblem& p, Real objective) {
    return at_least(math::fabs(objective), p.no_force_cost);
  }
  // Residual and duality gap |x.g| within `slack` times the tolerances.
  static bool has_converged(const ScaledProblem& p, const Real x[6], const Real g[6], Real squared_norm, Real objective,
                            Real total_normal_force, Real slack) {
    return is_small(squared_norm, total_normal_force, slack * Tol::gradient) &&
           math::fabs(dot6(x, g)) <= slack * Tol::gap * gap_scale(p, objective);
  }

  struct OptimalityCheck {
    Forces forces;
    Measurement measured;
    bool is_optimal, is_loosely_optimal;
  };

  JAXGRASP_OUTLINE
  void check_optimality(const ScaledProblem& p, const Real x[6], OptimalityCheck& out) const {
    candidate_forces(p, x, out.forces);
    Measurement& m = out.measured;
    measure(p, out.forces, m);
    Real norm = squared_norm(p.metric, m.residual);
    out.is_optimal = has_converged(p, x, m.residual, norm, m.objective, m.total_normal_force, 1);
    out.is_loosely_optimal = has_converged(p, x, m.residual, norm, m.objective, m.total_normal_force, LOOSE_FACTOR);
  }

  // ---- Proof of infeasibility (solver/infeasibility.py) -----------------------------------------

  struct Certificate {
    Real linear[3], angular[3];  // A twist d with w.d > 0, along which no contact can push.
    Real force_bound = 0;        // Total normal force that it proves to be needed; 0 where it proves nothing.
  };

  // What a twist proves: sum of the normal forces >= w.d / max_i h_i(d), with h_i the work of contact i along d for
  // each unit of its normal force. Only a need far beyond the load is a proof; else 0.
  JAXGRASP_OUTLINE
  Real proven_force_bound(const ScaledProblem& p, const Real linear[3], const Real angular[3]) const {
    Real work = 0, size = 0;
    for (int i = 0; i < 3; i++) {
      work += p.data.force[i] * linear[i] + p.data.torque[i] * angular[i];
      size += linear[i] * linear[i] + angular[i] * angular[i];
    }
    if (!(work > 0)) {
      if constexpr (!Bounded) {
        bool holds_squeeze = false;
        for (int b = 0; b < blocks_; b++)
          holds_squeeze |= !all_true<Real>((p.data.weight[b] > Real(0)) | (p.data.squeeze[b] == Real(0)));
        if (!holds_squeeze) return 0;
      }
    }
    V most = zero(), bounded_work = zero(), bounds = zero(), grip = constant(1), reach = constant(1);
    for (int b = 0; b < blocks_; b++) {
      V velocity[D], across[D];
      velocity_at(p, b, linear, angular, velocity);
      const V *a = p.data.normal[b], mu = p.data.friction[b];
      V along = dot3(velocity, a);
      for (int i = 0; i < 3; i++) across[i] = velocity[i] - along * a[i];
      if constexpr (Soft) across[3] = velocity[3];
      // v_a + mu |v_t|
      V push = along + mu * square_root<Real>(dot(across, across)), endless = push, limited = zero();
      if constexpr (Bounded) {
        V low = p.data.normal_min[b], high = p.data.normal_max[b];
        M ends = high < INF;
        endless = ends ? zero() : push;
        V above = ends ? push * (ends ? high : zero()) : zero();
        limited = push > Real(0) ? above : push * low;
      }
      M adjustable = p.data.weight[b] > Real(0);
      V candidate = adjustable ? endless : zero();
      most = candidate > most ? candidate : most;
      if (!all_true<Real>(candidate == candidate)) return 0;  // NaN proves nothing.
      bounded_work += adjustable ? limited : p.data.squeeze[b] * along;
      V bound = zero();
      if constexpr (Bounded) bound = p.data.normal_max[b] < INF ? p.data.normal_max[b] : p.data.normal_min[b];
      bounds += adjustable ? bound : p.data.squeeze[b];
      V friction = adjustable ? mu : zero();
      grip = friction > grip ? friction : grip;
      const V* r = p.data.point[b];
      V lever = magnitude<Real>(r[0]) + magnitude<Real>(r[1]) + magnitude<Real>(r[2]);
      if constexpr (Soft) lever += p.data.spin_radius[b];
      lever *= Real(0.25);
      // Absent contacts, and lanes without a contact, lie anywhere.
      const M carries = adjustable | (p.data.squeeze[b] > Real(0));
      const M is_farther = carries & (lever > reach);
      reach = is_farther ? lever : reach;
    }
    work -= sum<Real>(bounded_work);
    // In the user's frame the direction loses its last digits, more of them the farther the frame is. Friction above 1
    // multiplies what the tangential velocities lose, and so do levers of contacts of little weight, far off.
    const Real factor = largest<Real>(grip) * largest<Real>(reach);
    Real rounding = 4 * EPS * math::sqrt(size) * rounding_growth(p.scaling) * factor;
    Real push = largest<Real>(most);
    work -= rounding * sum<Real>(bounds);
    bool proven = work > 0 && at_least(push, rounding) * Tol::proof <= work;
    return proven ? safe_divide_one(work, push + VERIFIER_ROUNDING * rounding) : Real(0);
  }
  bool proves(const ScaledProblem& p, const Real x[6], Certificate& out) const {
    twist_of(p, x, out.linear, out.angular);
    out.force_bound = proven_force_bound(p, out.linear, out.angular);
    return out.force_bound > 0;
  }

  // The first proof among the residual, the multiplier's displacement, and the residual turned away from the contacts.
  JAXGRASP_OUTLINE
  bool find_certificate(const ScaledProblem& p, const Real residual[6], const Real displacement[6],
                        Certificate& out) const {
    if (proves(p, residual, out)) return true;
    Real direction[6], size = at_least(norm6(displacement), 1);
    for (int i = 0; i < 6; i++) direction[i] = displacement[i] / size;
    if (proves(p, direction, out)) return true;
    turn_away(p, residual, direction);
    return proves(p, direction, out);
  }

  // Correct a direction by Newton steps on the sum of k_i max(push_i + margin, 0)^2 / 2, until no contact can push
  // along it: the residual tends to a direction along which some contacts just do not push, and until then they push a
  // little.
  JAXGRASP_OUTLINE
  void turn_away(const ScaledProblem& p, const Real start[6], Real direction[6]) const {
    for (int i = 0; i < 6; i++) direction[i] = start[i];
    const Real damping = math::sqrt(EPS);
    for (int turn = 0; turn < TURNS; turn++) {
      Real linear[3], angular[3];
      twist_of(p, direction, linear, angular);
      V push[BLOCKS], edge[BLOCKS][D], most = zero();
      for (int b = 0; b < blocks_; b++) {
        V velocity[D];
        Split split;
        velocity_at(p, b, linear, angular, velocity);
        decompose(velocity, p.data, b, false, split);
        M moves = p.data.weight[b] > Real(0);
        if constexpr (Bounded) moves = moves & !(p.data.normal_max[b] < INF);
        push[b] = moves ? split.along + p.data.friction[b] * split.size : constant(-INF);
        most = push[b] > most ? push[b] : most;
        for (int i = 0; i < D; i++) {
          V across = p.data.friction[b] * split.tangent[i];
          edge[b][i] = i < 3 ? p.data.normal[b][i] + across : across;
        }
      }
      Real largest_push = largest<Real>(most);
      V wrench[6], h[21];
      for (int i = 0; i < 6; i++) wrench[i] = zero();
      for (int i = 0; i < 21; i++) h[i] = zero();
      for (int b = 0; b < blocks_; b++) {
        V excess = push[b] + BEYOND * largest_push, rows[E], f[D];
        M is_excess = excess > Real(0);
        excess = is_excess ? excess : zero();
        for (int i = 0; i < D; i++) {
          f[i] = p.data.weight[b] * excess * edge[b][i];
          for (int j = 0; j <= i; j++) rows[entry(i, j)] = is_excess ? edge[b][i] * edge[b][j] : zero();
        }
        add_curvature(p.data, b, rows, h);
        add_wrench(p.data, b, f, wrench);
      }
      Real curvature[21], back[6], step[6];
      curvature_of(p, h, curvature);
      add_damping(curvature, p.metric, damping);
      for (int i = 0; i < 3; i++) back[i] = sum<Real>(wrench[i]), back[3 + i] = p.scales[i] * sum<Real>(wrench[3 + i]);
      solve_six(curvature, back, step);
      for (int i = 0; i < 6; i++) direction[i] -= step[i];
    }
  }

  // The load along axes about which no contact can turn the object; a proof where it exceeds rounding.
  JAXGRASP_OUTLINE
  bool is_out_of_range(const ScaledProblem& p, Certificate& out) const {
    Real size2 = 0;
    for (int i = 0; i < 3; i++) {
      out.linear[i] = 0;
      out.angular[i] = p.scales[i] > 0 ? Real(0) : p.data.torque[i];
      size2 += out.angular[i] * out.angular[i];
    }
    if (!(math::sqrt(size2) > Tol::range)) return false;
    out.force_bound = proven_force_bound(p, out.linear, out.angular);
    return out.force_bound > 0;
  }

  // ---- Newton's method on the dual (solver/newton.py) -------------------------------------------

  struct Newton {
    Real point[6];
    int steps;
    bool is_stalled;
  };

  // Maximise q(x) - strength/2 |x - centre|^2 by Newton's method with a line search; `start` is also the centre.
  JAXGRASP_OUTLINE
  void maximise(const ScaledProblem& p, const Real start[6], Real strength, int max_evaluations, Newton& state) const {
    Real direction[6] = {0, 0, 0, 0, 0, 0}, trial[6];
    Real value = -INF, slope = 0, length = 0, damping_factor = 1, last_norm = 0;
    for (int i = 0; i < 6; i++) state.point[i] = start[i];
    state.steps = 0;
    state.is_stalled = false;
    for (int evaluation = 0; evaluation < max_evaluations; evaluation++) {
      // x + t d
      for (int i = 0; i < 6; i++) trial[i] = state.point[i] + length * direction[i];
      DualEvaluation e;
      evaluate(p, trial, e);
      if (strength > 0) add_proximal_term(e, trial, start, strength);
      Real norm = squared_norm(p.metric, e.gradient);
      // The evaluation of the starting point, of length zero, is no step.
      state.steps += length > 0;
      if (!is_better(value, length, slope, last_norm, trial, e.value, norm)) {
        length *= step_reduction(slope, dot6(e.gradient, direction));
        if (!(length >= SHORTEST_STEP)) {
          state.is_stalled = true;
          return;
        }
        continue;
      }
      for (int i = 0; i < 6; i++) state.point[i] = trial[i];
      if (has_converged(p, trial, e.gradient, norm, e.value, e.total_normal_force, 1)) return;
      // A larger factor after a shortened step, a smaller one after a full step.
      damping_factor = length > 0 && length < 1 ? damping_factor / at_least(length, Real(1e-3))
                                                : at_least(damping_factor / 10, 1);
      // (H + damping M) d = g, with M = G W G^T the metric
      Real damping = strength > 0 ? strength * (damping_factor - 1) : DAMPING * damping_factor * math::sqrt(norm);
      add_damping(e.curvature, p.metric, 16 * EPS + at_most(damping, LARGEST_DAMPING));
      solve_six(e.curvature, e.gradient, direction);
      if (converges_next(length, norm, last_norm)) {
        for (int i = 0; i < 6; i++) state.point[i] += direction[i];
        state.steps++;
        return;
      }
      value = e.value, slope = dot6(e.gradient, direction), last_norm = norm, length = 1;
    }
  }
  // Add -rho/2 |x - c|^2: gradient -rho (x - c), Hessian -rho I.
  static void add_proximal_term(DualEvaluation& e, const Real x[6], const Real centre[6], Real rho) {
    for (int i = 0; i < 6; i++) {
      Real offset = x[i] - centre[i];
      e.value -= rho * offset * offset / 2;
      e.gradient[i] -= rho * offset;
      e.curvature[entry(i, i)] += rho;
    }
  }
  // Whether the value rises enough (Armijo), rounding aside: where the multiplier's size hides the rise, a smaller
  // residual shows it.
  static bool is_better(Real value, Real length, Real slope, Real last_norm, const Real trial[6], Real trial_value,
                        Real norm) {
    // q(x + t d) - q(x) - c t g.d
    Real rise = trial_value - value - ARMIJO * length * slope, noise = 8 * EPS * (1 + math::fabs(trial_value));
    return rise >= -noise || (rise >= -noise - 8 * EPS * norm6(trial) && norm < last_norm);
  }
  // Twice the share of the step at which the slope's chord is zero, s_0 / (s_0 - s_1), between a tenth and a half.
  static Real step_reduction(Real slope, Real slope_at_trial) {
    Real overshot = at_least(-slope_at_trial, slope);
    return at_most(at_least(2 * safe_divide_one(slope, slope + overshot), Real(0.1)), Real(0.5));
  }
  // Close to the optimum the residual falls as its own square: the next full step needs no evaluation. The caller
  // checks the point. |g| (|g| / |g_last|)^2 <= target, in squares.
  static bool converges_next(Real length, Real norm, Real last_norm) {
    Real target = Real(0.1) * Tol::gradient * last_norm;
    return length == 1 && norm < Real(1e-8) && norm * norm * norm <= target * target;
  }

  // ---- The phases (solver/phases.py, proximal.py) -----------------------------------------------

  struct Search {
    Real point[6];
    OptimalityCheck check;
    Certificate certificate;
    bool is_optimal = false, is_infeasible = false, is_stalled = false;
    int steps = 0;
  };

  // Maximise from the search's point, stage by stage: the proximal term holds the multiplier near that of the stage
  // before and shrinks tenfold. With a strength of zero it is Newton's method on the dual itself, once.
  JAXGRASP_OUTLINE
  void search_stages(const ScaledProblem& p, Search& s, Real strength, int evaluations, Real least_strength,
                     bool looks_for_proof) const {
    Newton newton;
    do {
      maximise(p, s.point, strength, evaluations, newton);
      Real displacement[6];
      for (int i = 0; i < 6; i++) displacement[i] = newton.point[i] - s.point[i], s.point[i] = newton.point[i];
      s.steps += newton.steps;
      s.is_stalled = newton.is_stalled;
      check_optimality(p, s.point, s.check);
      s.is_optimal = s.check.is_optimal;
      if (!s.is_optimal && looks_for_proof)
        s.is_infeasible = find_certificate(p, s.check.measured.residual, displacement, s.certificate);
      strength /= 10;
    } while (!s.is_optimal && !s.is_infeasible && strength >= least_strength);
  }

  // Bring forces to balance where their multiplier's own rounding stands in the way (solver/refinement.py): corrections
  // dx = (G k D G^T)^-1 (w - G f) move the targets by k G^T dx, at the end the forces by k D G^T dx.
  JAXGRASP_OUTLINE
  void refine(const ScaledProblem& p, Search& s) const {
    const Real target_residual = ENOUGH * Tol::balance, damping = s.is_optimal ? 16 * EPS : LEAST_DAMPING;
    Real point[6], linear[3], angular[3], least = 0;
    V aim[BLOCKS][D], jacobian[BLOCKS][E];
    for (int i = 0; i < 6; i++) point[i] = s.point[i];
    twist_of(p, point, linear, angular);
    for (int b = 0; b < blocks_; b++) {
      V velocity[D];
      velocity_at(p, b, linear, angular, velocity);
      target_at(p, b, velocity, aim[b]);
    }
    for (int step = 0; step <= REFINING_STEPS + CORRECTIONS; step++) {
      const bool by_target = step <= REFINING_STEPS, moves_target = step < REFINING_STEPS;
      Forces forces;
      for (int b = 0; b < blocks_; b++) {
        Split split;
        decompose(aim[b], p.data, b, true, split);
        project(aim[b], p.data, b, split, forces.at[b]);
        if (by_target) derivative(p.data, b, split, jacobian[b]);
      }
      Measurement m;
      measure(p, forces, m);
      // Forces of a target minimise the Lagrangian, whose value is then the dual's: a bound for what follows.
      if (by_target) least = m.objective + dot6(point, m.residual);
      Real gap = LOOSE_FACTOR * Tol::gap * gap_scale(p, m.objective), norm = squared_norm(p.metric, m.residual);
      s.steps++;
      if (m.relative_residual <= target_residual && m.objective - least <= gap &&
          is_small(norm, m.total_normal_force, LOOSE_FACTOR * Tol::gradient)) {
        for (int i = 0; i < 6; i++) s.point[i] = point[i];
        s.check.forces = forces;
        s.check.measured = m;
        s.is_optimal = true;
        return;
      }
      V h[21];
      for (int i = 0; i < 21; i++) h[i] = zero();
      for (int b = 0; b < blocks_; b++) add_curvature(p.data, b, jacobian[b], h);
      Real curvature[21], correction[6];
      curvature_of(p, h, curvature);
      add_damping(curvature, p.metric, damping);
      solve_six(curvature, m.residual, correction);
      twist_of(p, correction, linear, angular);
      for (int b = 0; b < blocks_; b++) {
        V moved[D];
        velocity_at(p, b, linear, angular, moved);
        for (int i = 0; i < D; i++) moved[i] *= p.data.weight[b];
        for (int i = 0; i < D; i++) {
          V along = zero();
          for (int j = 0; j < D; j++) along += jacobian[b][i >= j ? entry(i, j) : entry(j, i)] * moved[j];
          aim[b][i] = moves_target ? aim[b][i] + moved[i] : forces.at[b][i] + along;
        }
      }
      if (moves_target)
        for (int i = 0; i < 6; i++) point[i] += correction[i];
    }
  }
  bool needs_refinement(const Search& s) const {
    return IS_DOUBLE && s.is_optimal && s.check.measured.relative_residual > ENOUGH * Tol::balance;
  }

  // The multiplier of the closed form, eq. 10: G W G^T x = w - G s a, corrected once where the problem is
  // ill-conditioned.
  JAXGRASP_OUTLINE
  void closed_form(const ScaledProblem& p, Real x[6], Forces& forces, Measurement& m) const {
    for (int i = 0; i < 6; i++) x[i] = 0;
    for (int pass = 0; pass < (p.is_ill_conditioned ? 3 : 2); pass++) {
      Real linear[3], angular[3];
      twist_of(p, x, linear, angular);
      V wrench[6];
      for (int i = 0; i < 6; i++) wrench[i] = zero();
      for (int b = 0; b < blocks_; b++) {
        V velocity[D];
        velocity_at(p, b, linear, angular, velocity);
        // f = s a + k G^T x
        target_at(p, b, velocity, forces.at[b]);
        add_wrench(p.data, b, forces.at[b], wrench);
      }
      if (pass == (p.is_ill_conditioned ? 2 : 1)) break;
      Real residual[6], turn[3];
      unbalanced(p, wrench, residual);
      solve_three(p.metric, residual + 3, turn);
      for (int i = 0; i < 3; i++) x[i] += residual[i], x[3 + i] += turn[i];
    }
    measure(p, forces, m);
  }

 public:
  // Solve one problem; see `jaxgrasp::solve`.
  void solve(const Problem<Real>& problem, Solution<Real, MaxContacts>* closed_form_out,
             Solution<Real, MaxContacts>* optimum_out) {
    Solution<Real, MaxContacts>& first = closed_form_out != nullptr ? *closed_form_out : *optimum_out;
    const bool wants_both = closed_form_out != nullptr && optimum_out != nullptr;
    ScaledProblem p;
    Search closed;
    Verdict verdict = begin(problem, p, closed, first);
    if (verdict == CLOSED_FORM_OPTIMAL || verdict == OUTSIDE_CONES || verdict == NOT_CONVERGED) {
      if (closed_form_out != nullptr) {
        const bool is_hidden = verdict == CLOSED_FORM_OPTIMAL && closed.check.measured.is_hidden;
        write(p, closed, is_hidden ? FEASIBLE : verdict, *closed_form_out);
      }
      if (optimum_out != nullptr) find_optimum(problem, p, closed, verdict, *optimum_out);
    } else if (wants_both) {
      copy(first, *optimum_out);
    }
  }

 protected:
  // Phase 1: the closed form (eqs. 11 and 15) and its verdict. What no later phase can change is written at once:
  // INVALID_DATA, NO_CONTACTS, INFEASIBLE.
  Verdict begin(const Problem<Real>& problem, ScaledProblem& p, Search& closed, Solution<Real, MaxContacts>& out) {
    bool is_valid = read(problem);
    clear(out, is_valid ? NO_CONTACTS : INVALID_DATA);
    if (!is_valid) return INVALID_DATA;
    scale(Axes::SUITABLE, true, p);
    if (!p.scaling.is_sound) return clear(out, INVALID_DATA), INVALID_DATA;
    closed_form(p, closed.point, closed.check.forces, closed.check.measured);
    if (!(p.scaling.weight_sum > 0)) return write_without_contacts(p, closed, out), NO_CONTACTS;
    out.route = p.is_ill_conditioned ? ROBUST : CLOSED_FORM;
    if (p.is_ill_conditioned && is_out_of_range(p, closed.certificate))
      return write(p, closed, INFEASIBLE, out), INFEASIBLE;
    // `not <=` rather than `>`, so that a NaN is not balanced.
    if (!(closed.check.measured.relative_residual <= Tol::balance)) return NOT_CONVERGED;
    return contains(p, closed.check.forces) ? CLOSED_FORM_OPTIMAL : OUTSIDE_CONES;
  }

  // The phases after the closed form.
  JAXGRASP_OUTLINE
  void find_optimum(const Problem<Real>& problem, const ScaledProblem& p, Search& closed, Verdict verdict,
                    Solution<Real, MaxContacts>& out) const {
    out.route = p.is_ill_conditioned ? ROBUST : CLOSED_FORM;
    const bool is_outside = verdict == OUTSIDE_CONES;
    bool is_hidden = verdict == CLOSED_FORM_OPTIMAL && closed.check.measured.is_hidden;
    write(p, closed, verdict == CLOSED_FORM_OPTIMAL ? CLOSED_FORM_OPTIMAL : NOT_CONVERGED, out);
    is_hidden = is_hidden && out.verdict == CLOSED_FORM_OPTIMAL;
    if (out.verdict == CLOSED_FORM_OPTIMAL && !is_hidden) return;
    // Phase 2: Newton's method on the dual, from the closed form's multiplier or the given one, where the axes suit it.
    bool comes_from_newton = false;
    if (is_outside && !p.is_ill_conditioned) {
      comes_from_newton = true;
      is_hidden = false;
      start_from_multiplier(problem.start, p, closed.point);
      if (newton_phases(p, closed, out, is_hidden) && !is_hidden) return;
    }
    robust_phases(closed, comes_from_newton, is_hidden, out);
  }
  // The coordinates of a multiplier in the user's units; one that is not finite is no start.
  static void start_from_multiplier(const Real* start, const ScaledProblem& p, Real point[6]) {
    if (start == nullptr) return;
    for (int i = 0; i < 6; i++)
      if (!(math::fabs(start[i]) < INF)) return;
    const Scaling& s = p.scaling;
    Real linear[3], angular[3], moved[3], unit = s.weight_sum / s.force_unit;
    // The twist about the centre: v + omega x c.
    cross(start + 3, s.centre, moved);
    for (int i = 0; i < 3; i++) linear[i] = start[i] + moved[i], angular[i] = start[3 + i];
    if (s.is_turned) {
      Real turned[3];
      rotate(s.axes, linear, turned);
      for (int i = 0; i < 3; i++) linear[i] = turned[i];
      rotate(s.axes, start + 3, angular);
    }
    for (int i = 0; i < 3; i++) {
      point[i] = unit * linear[i];
      point[3 + i] = safe_divide_one(unit * s.length * angular[i], p.scales[i]);
    }
  }
  void copy(const Solution<Real, MaxContacts>& from, Solution<Real, MaxContacts>& to) const {
    for (int i = 0; i < 3 * n_; i++) to.forces[i] = from.forces[i];
    for (int i = 0; i < n_; i++) to.moments[i] = from.moments[i], to.normal_multiplier[i] = from.normal_multiplier[i];
    for (int i = 0; i < 6; i++) to.multiplier[i] = from.multiplier[i], to.certificate[i] = from.certificate[i];
    to.residual = from.residual, to.objective = from.objective, to.force_bound = from.force_bound;
    to.verdict = from.verdict, to.route = from.route, to.steps = from.steps, to.rank = from.rank;
  }

  // Newton's method in a few portions, a check after each; the first steps are seldom enough for a proof. Return
  // whether the problem has a verdict; `is_hidden` is set where rounding hides the load.
  JAXGRASP_OUTLINE
  bool newton_phases(const ScaledProblem& p, Search& s, Solution<Real, MaxContacts>& out, bool& is_hidden) const {
    static constexpr int EVALUATIONS[] = {5, 6, 8, 22};
    out.route = NEWTON;
    s.steps = 0;
    for (int phase = 0; phase < 4; phase++) {
      search_stages(p, s, 0, EVALUATIONS[phase], 1, phase > 0);
      if (needs_refinement(s)) refine(p, s);
      if (s.is_infeasible) return write(p, s, INFEASIBLE, out), true;
      if (s.is_optimal) {
        bool is_balanced = s.check.measured.relative_residual <= Tol::balance;
        write(p, s, is_balanced ? OPTIMAL : NOT_CONVERGED, out);
        is_balanced = out.verdict == OPTIMAL;
        is_hidden = is_balanced && s.check.measured.is_hidden;
        return is_balanced;
      }
      if (s.is_stalled) break;
    }
    write(p, s, NOT_CONVERGED, out);
    return false;
  }

  // Principal axes, whitened coordinates and a proximal term; then whether allowed forces exist at all, without
  // squeeze; then more steps and a term that shrinks further, for contacts with next to no friction.
  JAXGRASP_OUTLINE
  void robust_phases(const Search& last, bool comes_from_newton, bool is_hidden,
                     Solution<Real, MaxContacts>& out) const {
    ScaledProblem p;
    if (!is_hidden) {
      scale(Axes::PRINCIPAL, true, p);
      Search s;
      s.steps = out.steps;
      bool starts_near = comes_from_newton && IS_DOUBLE;
      start_from(starts_near ? &last : nullptr, p, s);
      if (robust_phase(p, s, starts_near ? NEAR_STRENGTH : FIRST_STRENGTH, STEPS_PER_STAGE, 4 * EPS, is_hidden, out) &&
          !is_hidden)
        return;
    }
    if (feasibility_phase(is_hidden, out)) return;
    if (IS_DOUBLE && !is_hidden) {
      scale(Axes::PRINCIPAL, true, p);
      Search s;
      s.steps = 0;
      start_from(nullptr, p, s);
      robust_phase(p, s, FIRST_STRENGTH, LONG_STEPS_PER_STAGE, LONG_MIN_PROXIMAL_WEIGHT, is_hidden, out);
    }
    // Loads that rounding of the forces hides are balanced, and no more is known.
    if (is_hidden && out.verdict <= OPTIMAL) out.verdict = FEASIBLE;
  }
  // Start from the multiplier that Newton's phases came to along the user's axes; null for zero.
  static void start_from(const Search* last, const ScaledProblem& p, Search& s) {
    for (int i = 0; i < 6; i++) s.point[i] = 0;
    if (last == nullptr) return;
    Real angular[3];
    rotate(p.scaling.axes, last->point, s.point);
    rotate(p.scaling.axes, last->point + 3, angular);
    for (int i = 0; i < 3; i++) s.point[3 + i] = safe_divide_one(angular[i], p.scales[i]);
  }
  JAXGRASP_OUTLINE
  bool robust_phase(const ScaledProblem& p, Search& s, Real strength, int steps, Real least_strength, bool& is_hidden,
                    Solution<Real, MaxContacts>& out) const {
    out.route = ROBUST;
    run_robust(p, s, strength, steps, least_strength);
    if (s.is_infeasible) return write(p, s, INFEASIBLE, out), true;
    bool is_balanced = s.check.measured.relative_residual <= Tol::balance;
    write(p, s, s.is_optimal && is_balanced ? OPTIMAL : NOT_CONVERGED, out);
    is_hidden = out.verdict == OPTIMAL && s.check.measured.is_hidden;
    return out.verdict == OPTIMAL;
  }
  JAXGRASP_OUTLINE
  void run_robust(const ScaledProblem& p, Search& s, Real strength, int steps, Real least_strength) const {
    s.is_infeasible = is_out_of_range(p, s.certificate);
    if (s.is_infeasible) {
      candidate_forces(p, s.point, s.check.forces);
      measure(p, s.check.forces, s.check.measured);
      return;
    }
    search_stages(p, s, strength, steps, least_strength, true);
    bool has_ended = !s.is_optimal && !s.is_infeasible;
    s.is_optimal = s.is_optimal || (has_ended && s.check.is_loosely_optimal);
    if (needs_refinement(s) || (IS_DOUBLE && !s.is_optimal && !s.is_infeasible)) refine(p, s);
  }

  // No squeeze and equal weights: proofs that no allowed forces exist hold, and forces that are allowed may not be the
  // optimum. Return whether that decides the problem.
  JAXGRASP_OUTLINE
  bool feasibility_phase(bool is_hidden, Solution<Real, MaxContacts>& out) const {
    ScaledProblem p;
    scale(Axes::PRINCIPAL, false, p);
    Search s;
    s.steps = out.steps;
    start_from(nullptr, p, s);
    run_robust(p, s, FIRST_STRENGTH, STEPS_PER_STAGE, 4 * EPS);
    if (!s.is_infeasible && !(s.is_optimal && s.check.measured.relative_residual <= Tol::balance)) return false;
    Real multiplier[6], bound = out.objective;
    for (int i = 0; i < 6; i++) multiplier[i] = out.multiplier[i];
    if (!p.scaling.is_sound) return false;
    if (s.is_infeasible) {
      write(p, s, INFEASIBLE, out);
    } else if (is_hidden) {
      // Forces whose load rounding hides are now known to be allowed, and stay as they are.
      if (out.verdict <= OPTIMAL) out.verdict = FEASIBLE;
      return true;
    } else {
      // They are the optimum where their cost, with squeeze, is the bound that the robust phase proved.
      Real no_force_cost, cost = user_cost(p, s.check.forces, no_force_cost);
      bool is_least = cost - bound <= Tol::gap * at_least(math::fabs(cost), no_force_cost);
      const bool is_still_hidden = s.check.measured.is_hidden;
      write(p, s, is_least && !is_still_hidden ? OPTIMAL : FEASIBLE, out);
      out.objective = cost;
    }
    for (int i = 0; i < 6; i++) out.multiplier[i] = multiplier[i];
    return true;
  }
  // The user's objective [N^2 by weight] of scaled forces, and that of zero forces.
  JAXGRASP_OUTLINE
  Real user_cost(const ScaledProblem& p, const Forces& forces, Real& no_force_cost) const {
    V cost = zero(), none = zero();
    for (int b = 0; b < blocks_; b++) {
      V f[D], deviation[D];
      for (int i = 0; i < D; i++) f[i] = p.scaling.force_unit * forces.at[b][i];
      for (int i = 0; i < 3; i++) deviation[i] = f[i] - user_.squeeze[b] * p.data.normal[b][i];
      if constexpr (Soft) deviation[3] = f[3];
      cost += safe_divide(dot(deviation, deviation), 2 * user_.weight[b]);
      none += safe_divide(user_.squeeze[b] * user_.squeeze[b], 2 * user_.weight[b]);
    }
    no_force_cost = sum<Real>(none);
    return sum<Real>(cost);
  }

  // ---- The result in the user's axes and units (solver/result.py, problem/scaling.py) -----------

  JAXGRASP_OUTLINE
  void clear(Solution<Real, MaxContacts>& out, Verdict verdict) const {
    for (int i = 0; i < n_; i++) {
      for (int j = 0; j < 3; j++) out.forces[3 * i + j] = 0;
      out.moments[i] = out.normal_multiplier[i] = 0;
    }
    for (int i = 0; i < 6; i++) out.multiplier[i] = out.certificate[i] = 0;
    out.residual = out.objective = out.force_bound = 0;
    out.verdict = verdict, out.route = CLOSED_FORM, out.steps = out.rank = 0;
  }
  JAXGRASP_OUTLINE
  void write(const ScaledProblem& p, const Search& s, Verdict verdict, Solution<Real, MaxContacts>& out) const {
    const Scaling& scaling = p.scaling;
    const Measurement& m = s.check.measured;
    const bool has_finite_forces = write_forces(p, s.check.forces, out);
    Real linear[3], angular[3], unit = safe_divide_one(scaling.force_unit, scaling.weight_sum);
    twist_of(p, s.point, linear, angular);
    write_normal_multipliers(p, linear, angular, unit, out);
    for (int i = 0; i < 3; i++) linear[i] *= unit, angular[i] *= unit;
    twist_from_scaled(scaling, linear, angular, out.multiplier);
    for (int i = 0; i < 6; i++) out.certificate[i] = 0;
    out.force_bound = 0;
    if (verdict == INFEASIBLE) {
      twist_from_scaled(scaling, s.certificate.linear, s.certificate.angular, out.certificate);
      out.force_bound = scaling.force_unit * s.certificate.force_bound;
    }
    out.residual = m.relative_residual;
    // Without an answer, the dual's value at the multiplier: no allowed forces cost less.
    bool is_answer = verdict == INFEASIBLE || verdict <= OUTSIDE_CONES;
    Real objective = is_answer ? m.objective : m.objective + dot6(s.point, m.residual);
    out.objective = unit * scaling.force_unit * objective;
    // Weights far below the forces have multipliers beyond the range of the precision.
    const Real multiplier_size = norm1(out.multiplier) + norm1(out.multiplier + 3);
    const bool is_in_range = multiplier_size + math::fabs(out.objective) < INF;
    if (verdict <= OPTIMAL ? !(has_finite_forces && is_in_range) : verdict == FEASIBLE && !has_finite_forces)
      verdict = NOT_CONVERGED;
    out.verdict = verdict;
    out.steps = verdict == CLOSED_FORM_OPTIMAL ? 0 : s.steps;
    out.rank = 3;
    for (int i = 0; i < 3; i++) out.rank += p.scales[i] > 0;
  }
  // Multipliers of the bounds: target less projection is k times a normal of what is allowed, the bound's own and on a
  // disc's rim the cone's (solver/dual.py).
  JAXGRASP_OUTLINE
  void write_normal_multipliers(const ScaledProblem& p, const Real linear[3], const Real angular[3], Real unit,
                                Solution<Real, MaxContacts>& out) const {
    if constexpr (!Bounded) {
      for (int i = 0; i < n_; i++) out.normal_multiplier[i] = 0;
    } else {
      for (int b = 0; b < blocks_; b++) {
        V velocity[D], target[D];
        Split split;
        split_target(p, b, linear, angular, velocity, target, split);
        V beyond = split.size - p.data.friction[b] * split.bound_normal_force;
        V excess = split.along - split.bound_normal_force + p.data.friction[b] * (beyond > Real(0) ? beyond : zero());
        V multiplier = split.on_bound ? safe_divide(excess, p.data.weight[b]) : zero();
        for (int l = 0; l < W && b * W + l < n_; l++)
          out.normal_multiplier[b * W + l] = unit * lane<Real>(multiplier, l);
      }
    }
  }
  // Write the forces and return whether they are finite.
  JAXGRASP_OUTLINE
  bool write_forces(const ScaledProblem& p, const Forces& forces, Solution<Real, MaxContacts>& out) const {
    const Scaling& scaling = p.scaling;
    Real total = 0;
    for (int i = 0; i < n_; i++) {
      Real f[3], turned[3];
      for (int j = 0; j < 3; j++) f[j] = turned[j] = lane<Real>(forces.at[i / W][j], i % W);
      if (scaling.is_turned) rotate_back(scaling.axes, f, turned);
      for (int j = 0; j < 3; j++) {
        out.forces[3 * i + j] = scaling.force_unit * turned[j];
        total += math::fabs(turned[j]);
      }
      if constexpr (Soft)
        out.moments[i] = scaling.force_unit * scaling.length * lane<Real>(p.data.spin_radius[i / W], i % W) *
                         lane<Real>(forces.at[i / W][3], i % W);
    }
    return total * scaling.force_unit < INF;
  }
  // A twist about the problem's centre as one about the user's origin.
  static void twist_from_scaled(const Scaling& s, const Real linear[3], const Real angular[3], Real out[6]) {
    Real turned[3] = {linear[0], linear[1], linear[2]}, spin[3] = {angular[0], angular[1], angular[2]}, moved[3];
    if (s.is_turned) rotate_back(s.axes, linear, turned), rotate_back(s.axes, angular, spin);
    for (int i = 0; i < 3; i++) spin[i] /= s.length;
    cross(spin, s.centre, moved);
    for (int i = 0; i < 3; i++) out[i] = turned[i] - moved[i], out[3 + i] = spin[i];
  }
  // No contact can move: the squeezing forces, and the wrench that they leave unbalanced as the certificate.
  void write_without_contacts(const ScaledProblem& p, const Search& s, Solution<Real, MaxContacts>& out) const {
    write(p, s, NO_CONTACTS, out);
    out.rank = 0;
    out.steps = 0;
    const Measurement& m = s.check.measured;
    if (norm6(m.residual) > Tol::range) twist_from_scaled(p.scaling, m.force, m.torque, out.certificate);
  }
};

// Solve one problem: the optimum of its n_contacts <= MaxContacts contacts, a proof that there is none, or
// NOT_CONVERGED. More contacts, a negative number of them, or a missing array are INVALID_DATA, and no force is
// written.
template <class Real, int MaxContacts>
inline void solve(const Problem<Real>& problem, Solution<Real, MaxContacts>& solution) {
  const int n = problem.n_contacts;
  const bool has_contact_arrays = problem.points != nullptr && problem.normals != nullptr &&
                                  problem.friction != nullptr && problem.squeeze != nullptr;
  const bool has_arrays = problem.wrench != nullptr && (n == 0 || has_contact_arrays);
  if (n < 0 || n > MaxContacts || !has_arrays) {
    solution = Solution<Real, MaxContacts>();
    solution.verdict = INVALID_DATA;
    return;
  }
  const bool is_bounded = problem.normal_min != nullptr || problem.normal_max != nullptr;
  if (problem.torsion != nullptr) {
    if (is_bounded) GraspSolver<Real, MaxContacts, true, true>().solve(problem, nullptr, &solution);
    else GraspSolver<Real, MaxContacts, true, false>().solve(problem, nullptr, &solution);
  } else {
    if (is_bounded) GraspSolver<Real, MaxContacts, false, true>().solve(problem, nullptr, &solution);
    else GraspSolver<Real, MaxContacts, false, false>().solve(problem, nullptr, &solution);
  }
}

}  // namespace jaxgrasp

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic pop
#endif
#endif
