// Derivatives of one grasp's answer in reverse: the pullback of solver/derivative.py by hand.
//
//     jaxgrasp::Pullback<double, 20, false, false>().pull_back(problem, answer, cotangents, true, result);
//
// At an answer w - G f(x, data) = 0. Cotangents of the forces and of x come to x; the symmetric system H l = them, with
// H = sum of k_i G_i D_i G_i^T, gives the cotangent l of what is left of the wrench; and both go on to the data. The
// scaling is a constant, since the answer does not depend on it.
#ifndef JAXGRASP_KERNEL_PULLBACK_H
#define JAXGRASP_KERNEL_PULLBACK_H

#include "one_grasp.h"

namespace jaxgrasp {

// An answer, in the user's units.
template <class Real> struct Answer {
  const Real* forces;      // [3 n]
  const Real* multiplier;  // [6]
  int verdict;
};

// Derivatives of a number by an answer; null where the answer has no such field, all of them to ask only whether the
// answer has derivatives.
template <class Real> struct AnswerCotangents {
  const Real* forces;             // [3 n]
  const Real* multiplier;         // [6]
  const Real* objective;          // [1]
  const Real* moments;            // [n]
  const Real* normal_multiplier;  // [n]
};

// Derivatives of that number by a problem; null where it is not wanted.
template <class Real> struct ProblemCotangents {
  Real *points, *normals, *friction, *squeeze, *wrench, *weights, *torsion, *normal_min, *normal_max;
};

template <class Real, int MaxContacts, bool Soft, bool Bounded>
class Pullback : GraspSolver<Real, MaxContacts, Soft, Bounded> {
  using Base = GraspSolver<Real, MaxContacts, Soft, Bounded>;
  using typename Base::ScaledProblem;
  using typename Base::Scaling;
  using Tol = Tolerances<Real>;
  static constexpr int W = JAXGRASP_LANES, D = Base::D;

  // Data of one contact in the scaled coordinates, and the derivatives by them.
  struct Contact {
    Real point[3] = {0, 0, 0}, normal[3] = {0, 0, 0}, friction = 0, squeeze = 0, weight = 0, spin_radius = 0, low = 0,
         high = 0;
  };
  // A target split as in friction_cone.py.
  struct Region {
    Real along, size, tangent[4], edge_normal_force, height;
    bool inside, polar, is_risen, at_bound, at_low;
  };

  ScaledProblem p_;
  bool constrained_ = true;
  Real x_[6], linear_[3], angular_[3];

  static Real dot(const Real* a, const Real* b, int size) {
    Real total = 0;
    for (int i = 0; i < size; i++) total += a[i] * b[i];
    return total;
  }
  static void add_cross(const Real a[3], const Real b[3], Real factor, Real out[3]) {
    Real c[3];
    Base::template cross<Real>(a, b, c);
    for (int i = 0; i < 3; i++) out[i] += factor * c[i];
  }

  Contact contact(int i) const {
    const auto& c = p_.data;
    const int b = i / W, l = i % W;
    Contact out;
    for (int j = 0; j < 3; j++) {
      out.point[j] = lane<Real>(c.point[b][j], l);
      out.normal[j] = lane<Real>(c.normal[b][j], l);
    }
    out.friction = lane<Real>(c.friction[b], l), out.squeeze = lane<Real>(c.squeeze[b], l);
    out.weight = lane<Real>(c.weight[b], l);
    if constexpr (Soft) out.spin_radius = lane<Real>(c.spin_radius[b], l);
    if constexpr (Bounded) out.low = lane<Real>(c.normal_min[b], l), out.high = lane<Real>(c.normal_max[b], l);
    return out;
  }
  // v + omega x r, and the spin gamma omega.a of a soft finger; of the multiplier or another twist.
  static void velocity(const Contact& c, const Real linear[3], const Real angular[3], Real out[4]) {
    for (int i = 0; i < 3; i++) out[i] = linear[i];
    add_cross(angular, c.point, 1, out);
    out[3] = c.spin_radius * dot(angular, c.normal, 3);
  }
  static void target(const Contact& c, const Real v[4], Real u[4]) {
    for (int i = 0; i < 4; i++) u[i] = (i < 3 ? c.squeeze * c.normal[i] : Real(0)) + c.weight * v[i];
  }
  static bool is_fixed_at_zero(const Contact& c) { return c.squeeze == 0 && c.weight == 0; }

  static Region split(const Contact& c, const Real u[4]) {
    Region r;
    const Real mu = c.friction;
    r.along = dot(u, c.normal, 3);
    Real across[4] = {0, 0, 0, D > 3 ? u[3] : Real(0)};
    for (int i = 0; i < 3; i++) across[i] = u[i] - r.along * c.normal[i];
    const Real square = dot(across, across, D);
    r.size = math::sqrt(square);
    for (int i = 0; i < 4; i++) r.tangent[i] = Base::safe_divide_one(across[i], r.size);
    r.polar = mu * r.size < -r.along;
    r.inside = r.along >= 0 && square <= mu * r.along * (mu * r.along) && mu > 0;
    const Real rise = r.along + mu * r.size;
    r.is_risen = !(rise < 0);
    r.edge_normal_force = (r.is_risen ? rise : Real(0)) / (1 + mu * mu);
    r.at_bound = r.at_low = false;
    r.height = 0;
    if constexpr (Bounded) {
      const Real rest = dot(r.tangent, c.normal, 3);
      for (int i = 0; i < 3; i++) r.tangent[i] -= rest * c.normal[i];
      const Real free = r.inside ? r.along : r.polar ? Real(0) : r.edge_normal_force;
      r.height = Base::at_most(Base::at_least(free, c.low), c.high);
      r.at_bound = r.height != free;
      r.at_low = free < c.low;
      r.inside = r.inside && !r.at_bound, r.polar = r.polar && !r.at_bound;
    }
    return r;
  }
  static void project(const Contact& c, const Real u[4], const Region& r, Real f[4]) {
    const Real mu = c.friction, height = r.at_bound ? r.height : r.polar ? Real(0) : r.edge_normal_force;
    const Real rim = mu * height, reach = r.at_bound && r.size < rim ? r.size : rim;
    for (int i = 0; i < 4; i++) {
      const Real on_edge = (i < 3 ? height * c.normal[i] : Real(0)) + reach * r.tangent[i];
      f[i] = r.inside ? u[i] : on_edge;
    }
  }
  // D y, with D the projection's derivative by its target.
  static void by_target(const Contact& c, const Region& r, const Real y[4], Real out[4]) {
    const Real mu = c.friction, normal_part = dot(y, c.normal, 3), tangent_part = dot(y, r.tangent, D);
    Real isotropic = 0, turning = 0, along_edge = 0;
    if (r.at_bound) {
      const bool is_flat = r.size <= mu * r.height;
      turning = is_flat ? Real(0) : Base::safe_divide_one(mu * r.height, r.size);
      isotropic = is_flat ? Real(1) : turning;
      for (int i = 0; i < 4; i++)
        out[i] = isotropic * (y[i] - (i < 3 ? normal_part * c.normal[i] : Real(0))) -
                 turning * tangent_part * r.tangent[i];
      return;
    }
    if (!r.inside && !r.polar) {
      turning = Base::safe_divide_one(mu * r.edge_normal_force, r.size);
      along_edge = 1 / (1 + mu * mu);
    }
    isotropic = r.inside ? Real(1) : turning;
    const Real edge_part = normal_part + mu * tangent_part;
    for (int i = 0; i < 4; i++) {
      const Real a = i < 3 ? c.normal[i] : Real(0), t = r.tangent[i];
      out[i] = isotropic * y[i] + along_edge * edge_part * (a + mu * t) -
               turning * (normal_part * a + tangent_part * t);
    }
  }
  // (f - s a) / k, and its limits as k falls to 0: `weighted_deviation` of solver/dual.py.
  void deviation(const Contact& c, const Real v[4], const Real f[4], Real out[4]) const {
    if (!constrained_) {
      for (int i = 0; i < 4; i++) out[i] = v[i];
    } else if (c.weight > 0) {
      for (int i = 0; i < 4; i++) out[i] = (f[i] - (i < 3 ? c.squeeze * c.normal[i] : Real(0))) / c.weight;
    } else if (c.squeeze > 0) {
      const Real along = dot(v, c.normal, 3);
      for (int i = 0; i < 4; i++) out[i] = c.friction > 0 ? v[i] : i < 3 ? along * c.normal[i] : Real(0);
    } else {
      Real u[4];
      relaxed_target(c, v, u);
      project(c, u, split(c, u), out);
      for (int i = 0; i < 3; i++) out[i] -= weight_unit() * c.normal[i];
    }
  }
  // A unit of weight in squeeze where both are the same number to the user.
  Real weight_unit() const { return p_.scaling.weight_sum / p_.scaling.force_unit; }
  void relaxed_target(const Contact& c, const Real v[4], Real u[4]) const {
    for (int i = 0; i < 4; i++) u[i] = (i < 3 ? weight_unit() * c.normal[i] : Real(0)) + v[i];
  }

  // Cotangents of one contact's force, of the objective and of the multiplier of its bound, to its data `out` and to
  // its velocity.
  void pull_contact(const Contact& c, const Real v[4], const Real given[4], Real objective, Real bound_multiplier,
                    Contact& out, Real of_velocity[4]) const {
    Real u[4], f[4], away[4], of_force[4], of_target[4] = {0, 0, 0, 0};
    target(c, v, u);
    const Region r = split(c, u);
    if (constrained_) project(c, u, r, f);
    else
      for (int i = 0; i < 4; i++) f[i] = u[i];
    // The objective d.(f - s a) - k |d|^2 / 2 is stationary in the deviation d.
    deviation(c, v, f, away);
    for (int i = 0; i < 4; i++) of_force[i] = given[i] + objective * away[i];
    out.squeeze -= objective * dot(away, c.normal, 3);
    out.weight -= objective * dot(away, away, D) / 2;
    for (int i = 0; i < 3; i++) out.normal[i] -= objective * c.squeeze * away[i];
    if (!constrained_) {
      // The closed form has multipliers of bounds too, those of its multiplier's forces.
      const Real none[4] = {0, 0, 0, 0};
      if (r.at_bound) pull_projection(c, u, r, none, bound_multiplier, out, of_target);
      for (int i = 0; i < 4; i++) of_target[i] += of_force[i];
    } else if (is_fixed_at_zero(c)) {
      Real relaxed[4];
      relaxed_target(c, v, relaxed);
      by_target(c, split(c, relaxed), of_force, of_target);
    } else {
      pull_projection(c, u, r, of_force, bound_multiplier, out, of_target);
    }
    // u = s a + k v
    out.squeeze += dot(of_target, c.normal, 3);
    out.weight += dot(of_target, v, D);
    for (int i = 0; i < 3; i++) out.normal[i] += c.squeeze * of_target[i];
    for (int i = 0; i < 4; i++) of_velocity[i] = i < D ? c.weight * of_target[i] : Real(0);
    // v = l + omega x r, spin gamma omega.a
    add_cross(of_velocity, angular_, 1, out.point);
    if constexpr (Soft) {
      out.spin_radius += of_velocity[3] * dot(angular_, c.normal, 3);
      for (int i = 0; i < 3; i++) out.normal[i] += of_velocity[3] * c.spin_radius * angular_[i];
    }
  }
  // Cotangents of the projection f, and of the multiplier of its bound, to its target u and to cone and bounds.
  static void pull_projection(const Contact& c, const Real u[4], const Region& r, const Real of_f[4],
                              Real bound_multiplier, Contact& out, Real of_u[4]) {
    if (r.inside)
      for (int i = 0; i < 4; i++) of_u[i] = of_f[i];
    if (r.inside || r.polar) return;
    const Real mu = c.friction;
    Real of_tangent[4], of_along = 0, of_size = 0;
    if (r.at_bound) {
      // h a + min(|u_t|, mu h) t
      const Real h = r.height, reach = r.size < mu * h ? r.size : mu * h;
      Real of_height = dot(of_f, c.normal, 3), of_reach = dot(of_f, r.tangent, D);
      for (int i = 0; i < 3; i++) out.normal[i] += h * of_f[i];
      for (int i = 0; i < 4; i++) of_tangent[i] = reach * of_f[i];
      if (r.size < mu * h) of_size += of_reach;
      else out.friction += h * of_reach, of_height += mu * of_reach;
      // (u_a - h + mu max(|u_t| - mu h, 0)) / k
      const Real beyond = Base::at_least(r.size - mu * h, 0), price = r.along - h + mu * beyond;
      const Real of_price = Base::safe_divide_one(bound_multiplier, c.weight);
      out.weight -= Base::safe_divide_one(of_price * price, c.weight);
      of_along += of_price;
      of_height -= of_price;
      if (beyond > 0) {
        out.friction += of_price * (beyond - mu * h);
        of_size += of_price * mu;
        of_height -= of_price * mu * mu;
      }
      (r.at_low ? out.low : out.high) += of_height;
    } else {
      // p (a + mu t), p = (u_a + mu |u_t|) / (1 + mu^2)
      const Real p = r.edge_normal_force, tangent_part = dot(of_f, r.tangent, D);
      const Real of_p = dot(of_f, c.normal, 3) + mu * tangent_part, share = r.is_risen ? of_p / (1 + mu * mu) : Real(0);
      for (int i = 0; i < 3; i++) out.normal[i] += p * of_f[i];
      for (int i = 0; i < 4; i++) of_tangent[i] = mu * p * of_f[i];
      out.friction += p * tangent_part + share * r.size - of_p * 2 * mu * p / (1 + mu * mu);
      of_along = share;
      of_size = share * mu;
    }
    Real of_across[4];
    if constexpr (Bounded) {
      // The tangent's rest along the normal is taken off: t - (t.a) a.
      const Real rest = dot(of_tangent, c.normal, 3);
      for (int i = 0; i < 3; i++) {
        out.normal[i] -= rest * r.tangent[i];
        of_tangent[i] -= rest * c.normal[i];
      }
    }
    const Real tangent_part = dot(of_tangent, r.tangent, D);
    for (int i = 0; i < 4; i++)
      of_across[i] =
          Base::safe_divide_one(of_tangent[i] - tangent_part * r.tangent[i], r.size) + of_size * r.tangent[i];
    // u_t = u - u_a a, u_a = u.a
    of_along -= dot(of_across, c.normal, 3);
    for (int i = 0; i < 3; i++) {
      out.normal[i] += of_along * u[i] - r.along * of_across[i];
      of_u[i] = of_across[i] + of_along * c.normal[i];
    }
    of_u[3] = D > 3 ? of_across[3] : Real(0);
  }

  // Some x with A x = right where there is one; pivots up to the tolerance count as zeros (numerics/pivoted_ldl.py).
  static void solve_pivoted(const Real matrix[6][6], const Real right[6], Real x[6]) {
    Real left[6][6], columns[6][6], inverse[6], rest[6], part[6];
    int order[6];
    bool is_free[6];
    for (int i = 0; i < 6; i++) {
      is_free[i] = true, rest[i] = right[i], x[i] = 0;
      for (int j = 0; j < 6; j++) left[i][j] = matrix[i][j];
    }
    for (int step = 0; step < 6; step++) {
      int chosen = 0;
      Real most = -2;
      for (int i = 0; i < 6; i++)
        if (is_free[i] && left[i][i] > most) most = left[i][i], chosen = i;
      order[step] = chosen, is_free[chosen] = false;
      inverse[step] = most > Tol::singular ? 1 / most : Real(0);
      for (int i = 0; i < 6; i++) columns[step][i] = is_free[i] ? left[i][chosen] * inverse[step] : Real(0);
      for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++) left[i][j] -= columns[step][i] * left[chosen][j] * (is_free[j] || j == chosen);
      part[step] = rest[chosen] * inverse[step];
      for (int i = 0; i < 6; i++) rest[i] -= columns[step][i] * rest[chosen];
    }
    for (int step = 5; step >= 0; step--) {
      Real total = part[step];
      for (int i = 0; i < 6; i++) total -= columns[step][i] * x[i];
      x[order[step]] = total;
    }
  }
  // H l = right, with a correction of what is left.
  void solve_adjoint(const Real right[6], Real out[6]) const {
    Real h[6][6] = {};
    for (int i = 0; i < this->n_; i++) {
      const Contact c = contact(i);
      Real v[4], u[4];
      velocity(c, linear_, angular_, v);
      target(c, v, u);
      const Region r = split(c, u);
      for (int j = 0; j < 6; j++) {
        // Column j of G_i^T, then of k D G_i^T, and its wrench.
        Real axis_linear[3] = {}, axis_angular[3] = {}, moved[4], force[4], wrench[6] = {};
        (j < 3 ? axis_linear[j] : axis_angular[j - 3]) = j < 3 ? Real(1) : p_.scales[j - 3];
        velocity(c, axis_linear, axis_angular, moved);
        if (constrained_) by_target(c, r, moved, force);
        else
          for (int m = 0; m < 4; m++) force[m] = moved[m];
        for (int m = 0; m < 4; m++) force[m] *= c.weight;
        add_wrench(c, force, wrench);
        for (int m = 0; m < 6; m++) h[m][j] += m < 3 ? wrench[m] : p_.scales[m - 3] * wrench[m];
      }
    }
    Real rest[6], more[6];
    solve_pivoted(h, right, out);
    for (int i = 0; i < 6; i++) rest[i] = right[i] - dot(h[i], out, 6);
    solve_pivoted(h, rest, more);
    for (int i = 0; i < 6; i++) out[i] += more[i];
  }
  // Add the wrench of a contact's force: force, then torque r x f and the moment about the normal.
  static void add_wrench(const Contact& c, const Real f[4], Real wrench[6]) {
    for (int i = 0; i < 3; i++) wrench[i] += f[i], wrench[3 + i] += c.spin_radius * f[3] * c.normal[i];
    add_cross(c.point, f, 1, wrench + 3);
  }

  // Whether the answer is that of its multiplier: allowed forces that are not the optimum have no derivative.
  bool is_of_multiplier(const Answer<Real>& answer) const {
    constexpr Real least = sizeof(Real) == 8 ? Real(5.474e-07) : Real(1.7e-03);  // eps^0.4
    Real difference = 0, size = 0;
    for (int i = 0; i < this->n_; i++) {
      const Contact c = contact(i);
      Real v[4], u[4], f[4], turned[3];
      velocity(c, linear_, angular_, v);
      target(c, v, u);
      if (constrained_ && !is_fixed_at_zero(c)) project(c, u, split(c, u), f);
      else
        for (int j = 0; j < 4; j++) f[j] = u[j];
      Base::rotate_back(p_.scaling.axes, f, turned);
      for (int j = 0; j < 3; j++) {
        const Real force = answer.forces[3 * i + j];
        difference = Base::at_least(difference, math::fabs(p_.scaling.force_unit * turned[j] - force));
        size = Base::at_least(size, math::fabs(force));
      }
    }
    return difference <= least * size;
  }

  void clear(int n, const ProblemCotangents<Real>& out) const {
    Real* const arrays[] = {out.points, out.normals, out.friction,   out.squeeze,   out.wrench,
                            out.weights, out.torsion, out.normal_min, out.normal_max};
    const int lengths[] = {3 * n, 3 * n, n, n, 6, n, n, n, n};
    for (int j = 0; j < 9; j++)
      for (int i = 0; arrays[j] != nullptr && i < lengths[j]; i++) arrays[j][i] = 0;
  }

 public:
  // Compute the derivatives by the problem, zeros where there are none; return whether the answer has derivatives.
  // `constrained` says whether it is the optimum or the closed form.
  bool pull_back(const Problem<Real>& problem, const Answer<Real>& answer, const AnswerCotangents<Real>& given,
                 bool constrained, const ProblemCotangents<Real>& out) {
    constrained_ = constrained;
    clear(problem.n_contacts, out);
    const int verdict = answer.verdict;
    if (verdict == NO_CONTACTS) return true;
    if (verdict != CLOSED_FORM_OPTIMAL && verdict != OPTIMAL && verdict != OUTSIDE_CONES && verdict != FEASIBLE)
      return false;
    const bool has_cotangents = given.forces != nullptr;
    if (verdict != FEASIBLE && !has_cotangents) return true;
    if (!this->read(problem)) return false;
    this->scale(Base::Axes::PRINCIPAL, true, p_);
    Base::start_from_multiplier(answer.multiplier, p_, x_);
    Base::twist_of(p_, x_, linear_, angular_);
    if (verdict == FEASIBLE && !is_of_multiplier(answer)) return false;
    if (has_cotangents) pull_answer(problem, given, out);
    return true;
  }

 private:
  void pull_answer(const Problem<Real>& problem, const AnswerCotangents<Real>& given,
                   const ProblemCotangents<Real>& out) const {
    const Scaling& s = p_.scaling;
    const Real unit = Base::safe_divide_one(s.force_unit, s.weight_sum), force_unit = s.force_unit;
    const Real objective = unit * force_unit * *given.objective;
    Real of_x[6], of_twist[6];
    // The multiplier is unit (l - omega x c, omega), with omega by the length.
    Real angular[3] = {given.multiplier[3], given.multiplier[4], given.multiplier[5]};
    add_cross(s.centre, given.multiplier, -1, angular);
    Base::rotate(s.axes, given.multiplier, of_twist);
    Base::rotate(s.axes, angular, of_twist + 3);
    for (int i = 0; i < 3; i++) of_twist[i] *= unit, of_twist[3 + i] *= unit / s.length;
    for (int i = 0; i < this->n_; i++) {
      Contact ignored;
      Real given_force[4], v[4], of_velocity[4];
      const Contact c = contact(i);
      force_cotangent(given, c, i, given_force);
      velocity(c, linear_, angular_, v);
      pull_contact(c, v, given_force, objective, unit * bound_cotangent(given, i), ignored, of_velocity);
      add_wrench(c, of_velocity, of_twist);
    }
    for (int i = 0; i < 3; i++) of_x[i] = of_twist[i], of_x[3 + i] = p_.scales[i] * of_twist[3 + i];
    Real of_wrench[6];
    solve_adjoint(of_x, of_wrench);
    for (int i = 0; i < 3; i++) of_wrench[3 + i] *= p_.scales[i];
    for (int i = 0; i < this->n_; i++) pull_data(problem, given, i, objective, unit, of_wrench, out);
    // w: force, and torque about the centre t - c x f, by force unit and length.
    Real torque[3];
    Base::rotate_back(s.axes, of_wrench, out.wrench);
    Base::rotate_back(s.axes, of_wrench + 3, torque);
    for (int i = 0; i < 3; i++) {
      out.wrench[i] /= force_unit;
      out.wrench[3 + i] = torque[i] = torque[i] / (force_unit * s.length);
    }
    add_cross(torque, s.centre, -1, out.wrench);
  }
  Real bound_cotangent(const AnswerCotangents<Real>& given, int i) const {
    return Bounded && given.normal_multiplier != nullptr ? given.normal_multiplier[i] : Real(0);
  }
  void force_cotangent(const AnswerCotangents<Real>& given, const Contact& c, int i, Real out[4]) const {
    Base::rotate(p_.scaling.axes, given.forces + 3 * i, out);
    for (int j = 0; j < 3; j++) out[j] *= p_.scaling.force_unit;
    out[3] = 0;
    if constexpr (Soft) out[3] = p_.scaling.force_unit * p_.scaling.length * c.spin_radius * given.moments[i];
  }
  // Contact i: its force stands in the answer and in the wrench w - G f, whose cotangent is `of_wrench`.
  void pull_data(const Problem<Real>& problem, const AnswerCotangents<Real>& given, int i, Real objective, Real unit,
                 const Real of_wrench[6], const ProblemCotangents<Real>& out) const {
    if (problem.present != nullptr && !(problem.present[i] > Real(0.5))) return;
    const Scaling& s = p_.scaling;
    const Contact c = contact(i);
    Contact of;
    Real of_force[4], moved[4], v[4], u[4], f[4], of_velocity[4];
    force_cotangent(given, c, i, of_force);
    velocity(c, linear_, angular_, v);
    target(c, v, u);
    if (constrained_ && !is_fixed_at_zero(c)) project(c, u, split(c, u), f);
    else
      for (int j = 0; j < 4; j++) f[j] = u[j];
    if constexpr (Soft) of.spin_radius += s.force_unit * s.length * f[3] * given.moments[i];
    velocity(c, of_wrench, of_wrench + 3, moved);
    for (int j = 0; j < 4; j++) of_force[j] -= moved[j];
    // r x f + gamma f_4 a
    add_cross(f, of_wrench + 3, -1, of.point);
    if constexpr (Soft) {
      of.spin_radius -= f[3] * dot(c.normal, of_wrench + 3, 3);
      for (int j = 0; j < 3; j++) of.normal[j] -= c.spin_radius * f[3] * of_wrench[3 + j];
    }
    pull_contact(c, v, of_force, objective, unit * bound_cotangent(given, i), of, of_velocity);
    write(problem, c, of, i, out);
  }
  // From the scaled coordinates to the user's.
  void write(const Problem<Real>& problem, const Contact& c, const Contact& of, int i,
             const ProblemCotangents<Real>& out) const {
    const Scaling& s = p_.scaling;
    Real turned[3], unit_normal[3];
    Base::rotate_back(s.axes, of.point, turned);
    for (int j = 0; j < 3; j++) out.points[3 * i + j] = turned[j] / s.length;
    Base::rotate_back(s.axes, of.normal, turned);
    Base::rotate_back(s.axes, c.normal, unit_normal);
    const Real length = Base::norm3(problem.normals + 3 * i), along = dot(turned, unit_normal, 3);
    for (int j = 0; j < 3; j++) out.normals[3 * i + j] = (turned[j] - along * unit_normal[j]) / length;
    out.friction[i] = of.friction;
    if constexpr (Soft) {
      const Real mu = c.friction;
      out.torsion[i] = Base::safe_divide_one(of.spin_radius, mu * s.length);
      out.friction[i] -= Base::safe_divide_one(of.spin_radius * c.spin_radius, mu);
    }
    out.weights[i] = Base::safe_divide_one(of.weight, s.weight_sum);
    Real of_squeeze = of.squeeze / s.force_unit, of_low = of.low / s.force_unit, of_high = of.high / s.force_unit;
    if constexpr (Bounded) {
      // A contact that cannot move holds its squeeze, within the bounds.
      const Real low = problem.normal_min != nullptr ? problem.normal_min[i] : Real(0);
      const Real high = problem.normal_max != nullptr ? problem.normal_max[i] : Base::INF;
      if (!(c.weight > 0)) {
        // Where both are equal, each has half.
        const Real raised = Base::at_least(problem.squeeze[i], low);
        const Real by_high = raised > high ? Real(1) : raised == high ? Real(0.5) : Real(0);
        const Real by_low = problem.squeeze[i] < low ? Real(1) : problem.squeeze[i] == low ? Real(0.5) : Real(0);
        if (problem.normal_max != nullptr) of_high += by_high * of_squeeze, of_squeeze -= by_high * of_squeeze;
        if (problem.normal_min != nullptr) of_low += by_low * of_squeeze, of_squeeze -= by_low * of_squeeze;
      }
      if (out.normal_min != nullptr) out.normal_min[i] = of_low;
      if (out.normal_max != nullptr) out.normal_max[i] = of_high;
    }
    out.squeeze[i] = of_squeeze;
  }
};

}  // namespace jaxgrasp

#endif
