/* C interface of one_grasp.h: one function, float64, no allocation. Compile one_grasp_c.cpp once and link it. */
#ifndef JAXGRASP_KERNEL_ONE_GRASP_C_H
#define JAXGRASP_KERNEL_ONE_GRASP_C_H

#ifdef __cplusplus
extern "C" {
#endif

#define JAXGRASP_MAX_CONTACTS 64

/* One grasp and its wrench, in SI units about any frame's origin; arrays by contact, x y z of a vector together. */
struct jaxgrasp_problem {
  int n_contacts;           /* at most JAXGRASP_MAX_CONTACTS */
  const double *points;     /* [3 n] [m] */
  const double *normals;    /* [3 n] into the object */
  const double *friction;   /* [n] */
  const double *squeeze;    /* [n] intended normal forces [N] */
  const double *wrench;     /* [6] what the contacts must exert: force [N], torque [N.m] */
  const double *weights;    /* [n] sharing weights; NULL for the squeeze */
  const double *present;    /* [n] 1, or 0 for an absent contact; NULL: all are present */
  const double *torsion;    /* [n] torsional friction of soft fingers [m]; NULL: all contacts are hard */
  const double *normal_min; /* [n] bounds of the normal forces [N]; NULL where there are none */
  const double *normal_max; /* [n] */
};

/* What the forces are worth, and how they were found. */
struct jaxgrasp_answer {
  double multiplier[6];  /* of G f = w, about the frame's origin */
  double certificate[6]; /* of INFEASIBLE (3) and NO_CONTACTS (4): a twist d with w.d > 0 that no contact resists */
  double residual;       /* |w - G f| relative to the load */
  double objective;      /* sum of |f - s a|^2 / 2k; of NOT_CONVERGED (5) a lower bound */
  double force_bound;    /* total normal force that the certificate proves to be needed [N] */
  int verdict;           /* code of jaxgrasp.Verdict */
  int route;             /* code of jaxgrasp.Route */
  int steps;             /* Newton steps */
  int rank;              /* of the grasp matrix */
};

/* Solve one problem into forces [3 n], moments [n] (NULL where none are wanted) and answer; return the verdict.
 * 0 and 1 are the optimum, 7 allowed forces that balance the wrench; of other verdicts the forces do not hold the load.
 * More contacts than JAXGRASP_MAX_CONTACTS or a missing array give 6 (INVALID_DATA), and forces are not written. */
int jaxgrasp_solve_one_grasp(const struct jaxgrasp_problem *problem, double *forces, double *moments,
                             struct jaxgrasp_answer *answer);

#ifdef __cplusplus
}
#endif

#endif
