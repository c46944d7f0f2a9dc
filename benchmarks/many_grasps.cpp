// Solve many problems of as many contacts each, one after the other, so that a call from Python costs nothing beside it.
#include "one_grasp_c.h"

extern "C" void solve_many_grasps(int count, const jaxgrasp_problem* first, double* forces, double* moments,
                                  jaxgrasp_answer* answers) {
  const int n = first->n_contacts;
  for (long i = 0; i < count; i++) {
    jaxgrasp_problem problem = *first;
    const long contacts = i * n;
    problem.points += 3 * contacts;
    problem.normals += 3 * contacts;
    problem.friction += contacts;
    problem.squeeze += contacts;
    problem.wrench += 6 * i;
    if (problem.weights) problem.weights += contacts;
    if (problem.present) problem.present += contacts;
    if (problem.torsion) problem.torsion += contacts;
    if (problem.normal_min) problem.normal_min += contacts;
    if (problem.normal_max) problem.normal_max += contacts;
    jaxgrasp_solve_one_grasp(&problem, forces + 3 * contacts, moments ? moments + contacts : nullptr, answers + i);
  }
}
