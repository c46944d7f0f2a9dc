// Example of a controller: hold a ball with four fingers while its load changes, 1,000 times a second.
//
//     folder=$(jaxgrasp kernel --include)
//     g++ -std=c++17 -O3 -march=native -fno-math-errno -I$folder controller.cpp $folder/one_grasp_c.cpp -o controller
//     ./controller 5000
//
// Prints what the ticks cost. The exit code is 1 where a tick had no allowed forces, or half of the solves took longer than a tick.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "one_grasp_c.h"

int main(int count, char** arguments) {
  using Clock = std::chrono::steady_clock;
  const int ticks = count > 1 ? std::atoi(arguments[1]) : 1000;
  const auto period = std::chrono::milliseconds(1);
  // Fingertips on the equator of a ball of 3 cm: points [m], normals into it, friction, intended normal forces [N].
  const double points[] = {0.03, 0, 0, 0, 0.03, 0, -0.03, 0, 0, 0, -0.03, 0};
  const double normals[] = {-1, 0, 0, 0, -1, 0, 1, 0, 0, 0, 1, 0};
  const double friction[] = {0.6, 0.6, 0.6, 0.6};
  const double squeeze[] = {2, 2, 2, 2};
  double wrench[6], forces[12];
  jaxgrasp_problem problem = {};
  problem.n_contacts = 4;
  problem.points = points, problem.normals = normals, problem.friction = friction, problem.squeeze = squeeze;
  problem.wrench = wrench;
  std::vector<double> microseconds;
  int late = 0, active = 0;
  auto next = Clock::now();
  for (int tick = 0; tick < ticks; tick++) {
    // The contacts carry a weight of 3 N, a shake of 4 N and a twist; the wrench is what they must exert.
    const double t = 1e-3 * tick;
    wrench[0] = 4 * std::sin(9 * t), wrench[1] = 2 * std::cos(5 * t), wrench[2] = 3 + std::sin(13 * t);
    wrench[3] = wrench[4] = 0, wrench[5] = 0.03 * std::sin(3 * t);
    jaxgrasp_answer answer;
    const auto start = Clock::now();
    const int verdict = jaxgrasp_solve_one_grasp(&problem, forces, nullptr, &answer);
    microseconds.push_back(std::chrono::duration<double, std::micro>(Clock::now() - start).count());
    if (verdict != 0 && verdict != 1) {
      std::fprintf(stderr, "tick %d: verdict %d, residual %g\n", tick, verdict, answer.residual);
      return 1;
    }
    active += verdict == 1;
    // Here `forces` go to the fingers.
    next += period;
    late += Clock::now() > next;
    std::this_thread::sleep_until(next);
  }
  std::sort(microseconds.begin(), microseconds.end());
  const double median = microseconds[ticks / 2], most = microseconds[ticks - 1];
  std::printf("%d ticks, %d with an active cone: a solve takes %.1f us (median), %.1f us at most; %d ticks were late\n",
              ticks, active, median, most, late);
  return median < 1000 ? 0 : 1;
}
