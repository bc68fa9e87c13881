/* FMI 3.0 around the functions of a unit; "unit.h" says how many numbers they take and what the
   exported mechanism has. A row is what a function is called with: numbers of the mechanism as the
   steps take them, the state a step ago, what is handed on from step to step, both times, and of
   slopes 0 and the tangents of these; then 0 and as many numbers as it gives.
   With slopes there is a row for each of them in the steps of the unit and in each of the others by
   which they are judged. */
#include <stdlib.h>
#include <string.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <math.h>
typedef void function(const double *, double *, const double *const *);
#include "unit.h"
#if SLOPES
#define STEP jc_step_slope
#define STEP_TABLES jc_step_slope_tables
#else
#define STEP jc_step
#define STEP_TABLES jc_step_tables
#define MOVING 0
#define D_HANDED 0
#define OTHERS 0
#define CHANGED 0
#endif
#define ENDINGS (int)(sizeof ending / sizeof *ending)
#define NOT_ASSEMBLED \
  "With these parameters the mechanism cannot be assembled: its loops do not close, or parts start deep in each other."
#define NO_SLOPE "This unit carries slopes of its outputs along the numbers that were named in export_fmu only."
#define NOT_TRUSTED \
  "A slope at %g s is nan: in other steps it is another by more than a percent, so steps decide it. Take shorter ones."
#if defined _WIN32
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif
typedef void *I;
typedef uint32_t VR;
typedef int S;
enum { OK, WARNING, DISCARD, ERROR, FATAL };
enum { BEFORE, INITIALISING, RUNNING, TERMINATED };
#define PREVIOUS RUN
#define CARRY (PREVIOUS + STATE)
#define TIMES (CARRY + HANDED)
#define MOVED (TIMES + 3)
#define D_PREVIOUS (MOVED + MOVING)
#define D_CARRY (D_PREVIOUS + (SLOPES ? STATE : 0))
#define ROW (D_CARRY + D_HANDED + 1 + LARGEST)
#define EACH (1 + OTHERS)
#define ROWS (SLOPES ? SLOPES * EACH : 1)

/* All that changes while a unit runs, and is saved as its state. */
typedef struct {
  double given[GIVEN + 2 + SLOPES + LARGEST], row[ROWS][ROW], time, out[OUTPUTS + 1];
  int phase, changed, started, fresh;
} Memory;
typedef struct {
  Memory m;
  double result[ROWS][LARGEST + 1];
  void *environment;
  void (*log)(void *, S, const char *, const char *);
} Unit;

static S say(Unit *u, S status, const char *message, double number) {
  char text[2048];
  snprintf(text, sizeof text, message, number);
  if (u->log) u->log(u->environment, status, status == WARNING ? "logStatusWarning" : "logStatusError", text);
  return status;
}
static void begin_again(Unit *u) {
  memset(&u->m, 0, sizeof u->m);
  memcpy(u->m.given, given, sizeof given);
  for (int r = 0; r < ROWS; r++) {
    memcpy(u->m.row[r], run, sizeof run);
    memcpy(u->m.row[r] + CARRY, handed, sizeof handed);
    memcpy(u->m.row[r] + PREVIOUS, handed, STATE * sizeof(double));
    u->m.row[r][TIMES] = -INTERVAL;
  }
}
static I make(const char *token, void *environment, void *log) {
  if (strcmp(token, TOKEN)) return 0;
  Unit *u = calloc(1, sizeof *u);
  if (!u) return 0;
  u->environment = environment;
  u->log = (void (*)(void *, S, const char *, const char *))log;
  begin_again(u);
  return u;
}
/* The start from the parameters as they are set, and its tangents. */
static S start(Unit *u) {
  double out[LARGEST + 1], time = u->m.time;
  u->m.given[GIVEN] = time;
  if (u->m.changed || time != 0) {
    jc_start(u->m.given, out, jc_start_tables);
    if (!(out[1 + RUN + HANDED] > 0)) return say(u, ERROR, NOT_ASSEMBLED, time);
    for (int r = 0; r < ROWS; r++) {
      memcpy(u->m.row[r], out + 1, RUN * sizeof(double));
      memcpy(u->m.row[r] + CARRY, out + 1 + RUN, HANDED * sizeof(double));
      memcpy(u->m.row[r] + PREVIOUS, out + 1 + RUN, STATE * sizeof(double));
    }
  }
  for (int r = 0; r < ROWS; r++) {
#if SLOPES
    double *weights = u->m.given + GIVEN + 1;
    memset(weights, 0, SLOPES * sizeof(double));
    weights[r / EACH] = 1;
    jc_start_slope(u->m.given, out, jc_start_slope_tables);
    memcpy(u->m.row[r] + MOVED, out + 1, MOVING * sizeof(double));
    memcpy(u->m.row[r] + D_CARRY, out + 1 + MOVING, D_HANDED * sizeof(double));
    memcpy(u->m.row[r] + D_PREVIOUS, out + 1 + MOVING, STATE * sizeof(double));
    for (int k = 0; r % EACH && k < CHANGED; k++) u->m.row[r][changed_at[k]] = changed_to[(r % EACH - 1) * CHANGED + k];
    memset(weights, 0, SLOPES * sizeof(double));
#endif
    u->m.row[r][TIMES] = time - INTERVAL;
    u->m.row[r][TIMES + 1] = time;
  }
  return OK;
}
API const char *fmi3GetVersion(void) { return "3.0"; }
API S fmi3SetDebugLogging(I i, bool on, size_t n, const char *const c[]) { return OK; }
API I fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, bool visible, bool logging,
    bool events, bool early, const VR q[], size_t nq, void *environment, void *log, void *update) {
  return !events ? make(token, environment, log) : 0;
}
API I fmi3InstantiateModelExchange(const char *name, const char *token, const char *path, bool visible, bool logging,
    void *environment, void *log) {
  return STATES ? make(token, environment, log) : 0;
}
API I fmi3InstantiateScheduledExecution(const char *a, const char *b, const char *c, bool d, bool e, void *f, void *g,
    void *h, void *i, void *j) { return 0; }
API void fmi3FreeInstance(I i) { free(i); }
API S fmi3EnterInitializationMode(I i, bool td, double tolerance, double time, bool sd, double stop) {
  Unit *u = i;
  u->m.time = time;
  u->m.phase = INITIALISING;
  return OK;
}
/* What is read before initialisation has ended is that of the parameters set until then. */
static S ready(Unit *u) {
  if (u->m.phase != INITIALISING || u->m.started) return OK;
  S status = start(u);
  u->m.started = status == OK;
  return status;
}
API S fmi3ExitInitializationMode(I i) {
  Unit *u = i;
  if (ready(u) != OK) return ERROR;
  u->m.phase = RUNNING;
  if (DOUBT[0]) say(u, WARNING, DOUBT, 0);
  return OK;
}
API S fmi3Terminate(I i) {
  Unit *u = i;
  u->m.phase = TERMINATED;
#if CHECKS
  double out[LARGEST + 1];
  jc_check(u->m.row[0], out, jc_check_tables);
  for (int k = 0; k < CHECKS; k++)
    if (!(out[1 + k] <= check_limit[k])) say(u, WARNING, check_text[k], out[1 + k]);
#endif
  return OK;
}
API S fmi3Reset(I i) { begin_again(i); return OK; }
API S fmi3EnterStepMode(I i) { return OK; }
/* Of model exchange: a state, its rate or the depth of a contact, by number. */
#if STATES
static double exchanged(Unit *u, int k) {
  double out[LARGEST + 1];
  if (k < STATES) return u->m.row[0][CARRY + state_at[k]];
  jc_rate(u->m.row[0], out, jc_rate_tables);
  return out[1 + (k < 2 * STATES ? state_at[k - STATES] : STATE + k - 2 * STATES)];
}
#endif
API S fmi3GetFloat64(I i, const VR r[], size_t n, double v[], size_t nv) {
  Unit *u = i;
  if (ready(u) != OK) return ERROR;
  for (size_t k = 0; k < n; k++) {
    if (r[k] == 0) v[k] = u->m.time;
    else if (r[k] <= SETTABLE) v[k] = u->m.given[given_at[r[k] - 1]];
    else if (r[k] <= SETTABLE + OUTPUTS) {
      if (!u->m.fresh) jc_read(u->m.row[0], u->m.out, jc_read_tables);
      u->m.fresh = 1;
      v[k] = u->m.out[r[k] - SETTABLE];
    }
#if STATES
    else if (r[k] <= SETTABLE + OUTPUTS + 2 * STATES + CONTACTS) v[k] = exchanged(u, r[k] - SETTABLE - OUTPUTS - 1);
#endif
    else return ERROR;
  }
  return OK;
}
API S fmi3SetFloat64(I i, const VR r[], size_t n, const double v[], size_t nv) {
  Unit *u = i;
  for (size_t k = 0; k < n; k++) {
    int own = (int)r[k] - 1;
    if (own < 0 || own >= SETTABLE) return say(u, ERROR, "the variable of reference %.0f cannot be set.", r[k]);
    if (!(v[k] >= least[own] && v[k] <= most[own])) return say(u, ERROR, range_text[own], v[k]);
    if (own >= INPUTS && u->m.phase >= RUNNING)
      return say(u, ERROR, "parameters are fixed once a unit is initialised.", 0);
    if (u->m.phase < RUNNING && u->m.given[given_at[own]] != v[k]) {
      u->m.changed = 1;
      u->m.started = 0;
    }
    u->m.given[given_at[own]] = v[k];
    for (int j = 0; own < INPUTS && j < ROWS; j++) u->m.row[j][run_at[own]] = v[k];
    u->m.fresh = 0;
  }
  return OK;
}
API S fmi3DoStep(I i, double time, double length, bool noset, bool *event, bool *terminate, bool *early, double *last) {
  Unit *u = i;
  *event = *terminate = *early = false;
  *last = u->m.time;
  if (u->m.phase != RUNNING) return say(u, ERROR, "a step at %g s before initialisation or after termination.", time);
  if (!(length > 0) || !(fabs(time - u->m.time) <= 1e-6 * length))
    return say(u, ERROR, "a step must begin where the last one ended, at %.17g s, and be longer than 0 s.", u->m.time);
  for (int r = 0; r < ROWS; r++) {
    double *row = u->m.row[r];
    double before = row[TIMES], after = row[TIMES + 1];
    row[TIMES] = time;
    row[TIMES + 1] = time + length;
    STEP(row, u->result[r], STEP_TABLES);
    int outcome = u->result[r][1 + OUTCOME];
    if (r == 0 && outcome) {
      row[TIMES] = before;
      row[TIMES + 1] = after;
      *early = true;
      return say(u, DISCARD, ending[outcome < ENDINGS ? outcome : 0], time);
    }
  }
  for (int r = 0; r < ROWS; r++) {
    double *row = u->m.row[r], *result = u->result[r] + 1;
    memcpy(row + PREVIOUS, row + CARRY, STATE * sizeof(double));
    memcpy(row + CARRY, result, HANDED * sizeof(double));
#if SLOPES
    memcpy(row + D_PREVIOUS, row + D_CARRY, STATE * sizeof(double));
    memcpy(row + D_CARRY, result + HANDED, D_HANDED * sizeof(double));
#endif
  }
  *last = u->m.time = time + length;
  u->m.fresh = 0;
  return OK;
}
/* Slopes that are carried along: nan where those in other steps say otherwise. */
API S fmi3GetDirectionalDerivative(I i, const VR unknown[], size_t nu, const VR known[], size_t nk, const double seed[],
    size_t ns, double sensitivity[], size_t n) {
#if SLOPES
  Unit *u = i;
  double out[EACH][LARGEST + 1];
  if (ready(u) != OK) return ERROR;
  for (size_t j = 0; j < nu; j++) {
    if (unknown[j] <= SETTABLE || unknown[j] > SETTABLE + OUTPUTS) return say(u, ERROR, NO_SLOPE, 0);
    sensitivity[j] = 0;
  }
  for (size_t k = 0; k < nk; k++) {
    int slope = 0;
    while (slope < SLOPES && slope_of[slope] != known[k]) slope++;
    if (slope == SLOPES) return say(u, ERROR, NO_SLOPE, 0);
    for (int c = 0; c < EACH; c++) jc_read_slope(u->m.row[slope * EACH + c], out[c], jc_read_slope_tables);
    for (size_t j = 0; j < nu; j++) {
      int at = unknown[j] - SETTABLE;
      double own = out[0][OUTPUTS + at], number = fabs(u->m.given[given_at[known[k] - 1]]);
      double scale = fmax(fabs(own), number > 0 ? SMALLEST / number * fabs(out[0][at]) : 0);
      for (int c = 1; c < EACH; c++) {
        double *one = u->m.row[slope * EACH], *other = u->m.row[slope * EACH + c];
        double ratio = ORDER ? pow(one[CARRY + ACCEPTED] / other[CARRY + ACCEPTED], ORDER) : 0.5;
        double off = fabs(out[c][OUTPUTS + at] - own) / fabs(ratio - 1);
        if (one[CARRY + ACCEPTED] > 0 && own == own && !(off <= TRUSTED * scale)) {
          say(u, WARNING, NOT_TRUSTED, u->m.time);
          own = NAN;
        }
      }
      sensitivity[j] += seed[k] * own;
    }
  }
  return OK;
#else
  return ERROR;
#endif
}
API S fmi3GetFMUState(I i, void **s) {
  if (!*s) *s = malloc(sizeof(Memory));
  if (!*s) return ERROR;
  memcpy(*s, i, sizeof(Memory));
  return OK;
}
API S fmi3SetFMUState(I i, void *s) { memcpy(i, s, sizeof(Memory)); return OK; }
API S fmi3FreeFMUState(I i, void **s) { free(*s); *s = 0; return OK; }
API S fmi3SerializedFMUStateSize(I i, void *s, size_t *n) { *n = sizeof(Memory); return OK; }
API S fmi3SerializeFMUState(I i, void *s, uint8_t b[], size_t n) {
  if (n < sizeof(Memory)) return ERROR;
  memcpy(b, s, sizeof(Memory));
  return OK;
}
API S fmi3DeserializeFMUState(I i, const uint8_t b[], size_t n, void **s) {
  if (n != sizeof(Memory)) return ERROR;
  *s = 0;
  return fmi3GetFMUState((I)b, s);
}
#if STATES
API S fmi3EnterEventMode(I i) { return OK; }
API S fmi3EnterContinuousTimeMode(I i) { return OK; }
/* A contact that touches takes its impact speed, one that parts forgets it. */
API S fmi3UpdateDiscreteStates(I i, bool *again, bool *terminate, bool *nominals, bool *moved, bool *defined, double *next) {
  Unit *u = i;
  double out[LARGEST + 1], *state = u->m.row[0] + CARRY;
  jc_remember(u->m.row[0], out, jc_remember_tables);
  *again = *terminate = *nominals = *moved = *defined = false;
  for (int k = 0; k < STATES; k++) *moved |= state[state_at[k]] != out[1 + state_at[k]];
  memcpy(state, out + 1, STATE * sizeof(double));
  u->m.fresh = 0;
  return OK;
}
API S fmi3CompletedIntegratorStep(I i, bool noset, bool *event, bool *terminate) { *event = *terminate = false; return OK; }
API S fmi3SetTime(I i, double time) {
  Unit *u = i;
  u->m.time = u->m.row[0][TIMES + 1] = time;
  u->m.row[0][TIMES] = time - INTERVAL;
  u->m.fresh = 0;
  return OK;
}
API S fmi3SetContinuousStates(I i, const double x[], size_t n) {
  Unit *u = i;
  for (size_t k = 0; k < n && k < STATES; k++) u->m.row[0][CARRY + state_at[k]] = x[k];
  memcpy(u->m.row[0] + PREVIOUS, u->m.row[0] + CARRY, STATE * sizeof(double));
  u->m.fresh = 0;
  return OK;
}
API S fmi3GetContinuousStates(I i, double x[], size_t n) {
  for (size_t k = 0; k < n && k < STATES; k++) x[k] = exchanged(i, k);
  return OK;
}
static S rates(Unit *u, int first, double x[], size_t n) {
  double out[LARGEST + 1];
  jc_rate(u->m.row[0], out, jc_rate_tables);
  for (size_t k = 0; k < n; k++) {
    x[k] = out[1 + (first ? STATE + k : state_at[k])];
    if (!isfinite(x[k])) return say(u, DISCARD, "the rate of the state is not finite at %g s.", u->m.time);
  }
  return OK;
}
API S fmi3GetContinuousStateDerivatives(I i, double x[], size_t n) { return rates(i, 0, x, n < STATES ? n : STATES); }
API S fmi3GetEventIndicators(I i, double x[], size_t n) { return rates(i, 1, x, n < CONTACTS ? n : CONTACTS); }
API S fmi3GetNominalsOfContinuousStates(I i, double x[], size_t n) { while (n) x[--n] = 1; return OK; }
API S fmi3GetNumberOfEventIndicators(I i, size_t *n) { *n = CONTACTS; return OK; }
API S fmi3GetNumberOfContinuousStates(I i, size_t *n) { *n = STATES; return OK; }
#endif
#define NOT(f) API S f(void) { return ERROR; }
#if !STATES
NOT(fmi3EnterEventMode) NOT(fmi3UpdateDiscreteStates) NOT(fmi3EnterContinuousTimeMode) NOT(fmi3CompletedIntegratorStep)
NOT(fmi3SetTime) NOT(fmi3SetContinuousStates) NOT(fmi3GetContinuousStateDerivatives) NOT(fmi3GetEventIndicators)
NOT(fmi3GetContinuousStates) NOT(fmi3GetNominalsOfContinuousStates) NOT(fmi3GetNumberOfEventIndicators)
NOT(fmi3GetNumberOfContinuousStates)
#endif
NOT(fmi3GetFloat32) NOT(fmi3GetInt8) NOT(fmi3GetUInt8) NOT(fmi3GetInt16) NOT(fmi3GetUInt16) NOT(fmi3GetInt32)
NOT(fmi3GetUInt32) NOT(fmi3GetInt64) NOT(fmi3GetUInt64) NOT(fmi3GetBoolean) NOT(fmi3GetString) NOT(fmi3GetBinary)
NOT(fmi3GetClock) NOT(fmi3SetFloat32) NOT(fmi3SetInt8) NOT(fmi3SetUInt8) NOT(fmi3SetInt16) NOT(fmi3SetUInt16)
NOT(fmi3SetInt32) NOT(fmi3SetUInt32) NOT(fmi3SetInt64) NOT(fmi3SetUInt64) NOT(fmi3SetBoolean) NOT(fmi3SetString)
NOT(fmi3SetBinary) NOT(fmi3SetClock) NOT(fmi3GetNumberOfVariableDependencies) NOT(fmi3GetVariableDependencies)
NOT(fmi3GetAdjointDerivative) NOT(fmi3EnterConfigurationMode) NOT(fmi3ExitConfigurationMode)
NOT(fmi3GetIntervalDecimal) NOT(fmi3GetIntervalFraction) NOT(fmi3GetShiftDecimal) NOT(fmi3GetShiftFraction)
NOT(fmi3SetIntervalDecimal) NOT(fmi3SetIntervalFraction) NOT(fmi3SetShiftDecimal) NOT(fmi3SetShiftFraction)
NOT(fmi3EvaluateDiscreteStates) NOT(fmi3GetOutputDerivatives) NOT(fmi3ActivateModelPartition)
