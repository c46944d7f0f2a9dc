// The C interface of one_grasp.h: g++ -std=c++17 -O3 -march=native -fno-math-errno -shared -fPIC one_grasp_c.cpp
#include "one_grasp_c.h"

#include "one_grasp.h"

namespace {

// Solve with room for MaxContacts: little room for few contacts keeps the data in the cache.
template <int MaxContacts>
int solve_with_room(const jaxgrasp_problem* given, double* forces, double* moments, jaxgrasp_answer* answer) {
  jaxgrasp::Problem<double> problem;
  problem.n_contacts = given->n_contacts;
  problem.points = given->points;
  problem.normals = given->normals;
  problem.friction = given->friction;
  problem.squeeze = given->squeeze;
  problem.wrench = given->wrench;
  problem.weights = given->weights;
  problem.present = given->present;
  problem.torsion = given->torsion;
  problem.normal_min = given->normal_min;
  problem.normal_max = given->normal_max;
  jaxgrasp::Solution<double, MaxContacts> solution;
  jaxgrasp::solve(problem, solution);
  const bool has_contacts = given->n_contacts > 0 && given->n_contacts <= MaxContacts;
  for (int i = 0; has_contacts && i < 3 * given->n_contacts; i++) forces[i] = solution.forces[i];
  for (int i = 0; has_contacts && moments != nullptr && i < given->n_contacts; i++) moments[i] = solution.moments[i];
  for (int i = 0; i < 6; i++) {
    answer->multiplier[i] = solution.multiplier[i];
    answer->certificate[i] = solution.certificate[i];
  }
  answer->residual = solution.residual;
  answer->objective = solution.objective;
  answer->force_bound = solution.force_bound;
  answer->route = solution.route;
  answer->steps = solution.steps;
  answer->rank = solution.rank;
  return answer->verdict = solution.verdict;
}

}  // namespace

extern "C" int jaxgrasp_solve_one_grasp(const jaxgrasp_problem* problem, double* forces, double* moments,
                                        jaxgrasp_answer* answer) {
  if (problem->n_contacts <= 8) return solve_with_room<8>(problem, forces, moments, answer);
  return solve_with_room<JAXGRASP_MAX_CONTACTS>(problem, forces, moments, answer);
}
