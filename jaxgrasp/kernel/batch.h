// Solve a batch of problems, whose arrays hold one problem after the other; for calls from JAX and Python.
#ifndef JAXGRASP_KERNEL_BATCH_H
#define JAXGRASP_KERNEL_BATCH_H

#include "one_grasp.h"

namespace jaxgrasp {

// Arrays of one solution for each problem; null where the solution is not wanted.
template <class Real> struct SolutionArrays {
  Real *forces, *multiplier, *residual, *objective, *certificate, *force_bound, *moments, *normal_multiplier;
  int *verdict, *steps, *route, *rank;
};

// Data of a batch: `strides` are the distances from one problem to the next, in problems: 0 where all share one.
template <class Real> struct Batch {
  static constexpr int INPUTS = 11;
  // points, normals, friction, squeeze, wrench, weights, present, torsion, normal_min, normal_max, start; the last six
  // may be null.
  const Real* inputs[INPUTS];
  long long strides[INPUTS];
  long long n_contacts;
  SolutionArrays<Real> closed_form, optimum;
};

template <class Real, int MaxContacts>
inline void store(const Solution<Real, MaxContacts>& solution, long long i, int n, const SolutionArrays<Real>& out) {
  for (int j = 0; j < 3 * n; j++) out.forces[3 * n * i + j] = solution.forces[j];
  for (int j = 0; j < n; j++) {
    out.moments[n * i + j] = solution.moments[j];
    out.normal_multiplier[n * i + j] = solution.normal_multiplier[j];
  }
  for (int j = 0; j < 6; j++) {
    out.multiplier[6 * i + j] = solution.multiplier[j];
    out.certificate[6 * i + j] = solution.certificate[j];
  }
  out.residual[i] = solution.residual, out.objective[i] = solution.objective;
  out.force_bound[i] = solution.force_bound, out.verdict[i] = solution.verdict;
  out.steps[i] = solution.steps, out.route[i] = solution.route, out.rank[i] = solution.rank;
}

// Solve problem i of a batch.
template <class Real, int MaxContacts, bool Soft, bool Bounded>
inline void solve_in_batch(const Batch<Real>& batch, long long i) {
  const int n = int(batch.n_contacts);
  const int lengths[Batch<Real>::INPUTS] = {3 * n, 3 * n, n, n, 6, n, n, n, n, n, 6};
  const Real* at[Batch<Real>::INPUTS];
  for (int j = 0; j < Batch<Real>::INPUTS; j++)
    at[j] = batch.inputs[j] == nullptr ? nullptr : batch.inputs[j] + batch.strides[j] * lengths[j] * i;
  Problem<Real> problem;
  problem.n_contacts = n;
  problem.points = at[0], problem.normals = at[1], problem.friction = at[2], problem.squeeze = at[3];
  problem.wrench = at[4], problem.weights = at[5], problem.present = at[6], problem.torsion = at[7];
  problem.normal_min = at[8], problem.normal_max = at[9], problem.start = at[10];
  Solution<Real, MaxContacts> closed_form, optimum;
  const bool wants_closed_form = batch.closed_form.forces != nullptr, wants_optimum = batch.optimum.forces != nullptr;
  GraspSolver<Real, MaxContacts, Soft, Bounded>().solve(problem, wants_closed_form ? &closed_form : nullptr,
                                                        wants_optimum ? &optimum : nullptr);
  if (wants_closed_form) store(closed_form, i, n, batch.closed_form);
  if (wants_optimum) store(optimum, i, n, batch.optimum);
}

}  // namespace jaxgrasp

#endif
