/* Products of the volume part of a tangent with a vector, for a group of eight cells at a time: one in each lane of the
   processor's vector instructions.

   Slots, and the numbers of points, unknowns and moduli, are constants that are defined before this text. Moduli are
   ordered as the entries of slots (hpcinv/model/assembly/tangent_moduli.py), unknowns of a cell by part, component and node. */

#include <stddef.h>
#include <stdint.h>

enum { LANES = 8 };

typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

/* Slots: the number of the first unknown, and the place of the basis functions, or of their three derivatives, in the
   tables, (points, directions, nodes). */
typedef struct {
  int first, components, nodes, directions, table;
} slot;
static const slot trials[] = TRIALS, tests[] = TESTS;
enum { TRIAL_COUNT = sizeof trials / sizeof *trials, TEST_COUNT = sizeof tests / sizeof *tests };

static void to_point(const slot *of, const float *table, const lanes *nodes, lanes *values) {
  const int count = of->nodes;
  for (int component = 0; component < of->components; component++, nodes += count)
    if (of->directions == 3) {
      lanes a = {0}, b = {0}, c = {0};
      for (int node = 0; node < count; node++) {
        a += table[node] * nodes[node];
        b += table[count + node] * nodes[node];
        c += table[2 * count + node] * nodes[node];
      }
      *values++ = a, *values++ = b, *values++ = c;
    } else {
      lanes sum = {0};
      for (int node = 0; node < count; node++) sum += table[node] * nodes[node];
      *values++ = sum;
    }
}

static void to_nodes(const slot *of, const float *table, const lanes *duals, lanes *nodes) {
  const int count = of->nodes;
  for (int component = 0; component < of->components; component++, nodes += count, duals += of->directions)
    if (of->directions == 3) {
      const lanes a = duals[0], b = duals[1], c = duals[2];
      for (int node = 0; node < count; node++)
        nodes[node] += table[node] * a + table[count + node] * b + table[2 * count + node] * c;
    } else {
      const lanes dual = duals[0];
      for (int node = 0; node < count; node++) nodes[node] += table[node] * dual;
    }
}

/* Add K x to y.

   groups   number of groups of cells
   moduli   (groups, GIVEN, ROWS, COLUMNS, LANES), at the points where they are given
   shares   (POINTS, GIVEN): of these in the moduli at each point, times its weight
   tables   of all slots
   places   (groups, UNKNOWNS, LANES): where the unknowns of the cells are in x and y */
void multiply(int64_t groups, const lanes *moduli, const float *shares, const float *tables, const int32_t *places,
              const float *x, float *y) {
  const size_t size = ROWS * COLUMNS;
  for (; groups--; moduli += GIVEN * size, places += UNKNOWNS * LANES) {
    lanes from[UNKNOWNS], to[UNKNOWNS], values[COLUMNS], duals[ROWS];
    for (int i = 0; i < UNKNOWNS; i++) {
      for (int lane = 0; lane < LANES; lane++) from[i][lane] = x[places[i * LANES + lane]];
      to[i] = (lanes){0};
    }
    for (int point = 0; point < POINTS; point++) {
      const float *share = shares + point * GIVEN;
      lanes *value = values, *dual = duals;
      for (const slot *of = trials; of < trials + TRIAL_COUNT; value += of->components * of->directions, of++)
        to_point(of, tables + of->table + point * of->directions * of->nodes, from + of->first, value);
      for (int row = 0; row < ROWS; row++) {
        lanes sum = {0};
        for (int column = 0; column < COLUMNS; column++) {
          const lanes *given = moduli + row * COLUMNS + column;
          lanes modulus = {0};
          if (ARE_POINTS_GIVEN)
            modulus = share[point] * given[point * size];
          else
            for (int i = 0; i < GIVEN; i++) modulus += share[i] * given[i * size];
          sum += modulus * values[column];
        }
        duals[row] = sum;
      }
      for (const slot *of = tests; of < tests + TEST_COUNT; dual += of->components * of->directions, of++)
        to_nodes(of, tables + of->table + point * of->directions * of->nodes, dual, to + of->first);
    }
    for (int i = 0; i < UNKNOWNS; i++)
      for (int lane = 0; lane < LANES; lane++) y[places[i * LANES + lane]] += to[i][lane];
  }
}
