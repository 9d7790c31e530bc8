/* Interpreter of programs of scalar operations at quadrature points, and the kernels that DOLFINx calls.

   A program knows no law and no element. Its slots hold one number for each of LANES points; each operation reads up
   to three slots and writes one. The points of a cell are done in blocks of 4, 8 or 16 lanes; those that fill up the
   last block repeat the last point with weight zero. */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum {
  GATHER, CONSTANT, NUMBER,
  ADD, SUBTRACT, MULTIPLY, DIVIDE, MULTIPLY_ADD, SUBTRACT_PRODUCT, SCALE, SHIFT, NEGATE,
  LESS, LESS_EQUAL, EQUAL, SELECT, ABSOLUTE, SIGN, SQRT, POWER,
  EXP, LN, SIN, COS, TAN, SINH, COSH, TANH, ASIN, ACOS, ATAN, ERF
};

/* Value of a component of a function or of the coordinates, or of its derivative by one reference coordinate. */
typedef struct {
  int32_t source; /* 0: coefficients, 1: nodes of the cell, 2: none, the table itself */
  int32_t offset, stride, count;
  int32_t table;
} gather;

/* Basis functions by which an output is multiplied, and their places in the element's vector or matrix. */
typedef struct {
  int32_t offset, stride, count;
  int32_t table;
} basis;

/* Output at points: its slot, the rows and the columns to which it adds; bases are -1 where there are none. */
typedef struct {
  int32_t slot, row, column;
} output;

typedef struct {
  int32_t lanes, blocks, points, rank, operations, outputs, width, columns;
  const int32_t (*rows)[5]; /* operation, three arguments, result */
  const gather *gathers;
  const basis *bases;
  const output *results;
  const double *numbers, *tables; /* tables: (entities, tables, functions, padded points) */
  int64_t entity_size;
  const int32_t *places; /* column of each of `columns` basis functions of the trial function */
  double *slots, *products;
} program;

typedef struct {
  int32_t count;
  const program *programs;
} kernel;

/* Cells of a block of points, and distances from one to the next in nodal values, coordinates and results. */
typedef struct {
  int count;
  int64_t w, x, A;
} together;

#define EACH for (int p = 0; p < LANES; p++)
#define MAPPED(NAME, f) case NAME: EACH y[p] = f(a[p]); break;
#define SLOT(i) (slots + (int64_t)(i) * LANES)

static inline __attribute__((always_inline)) void run(const int LANES, const program *g, int block, together cells,
                                                      const double *w, const double *constants, const double *nodes,
                                                      const double *tables) {
  const int own = LANES / cells.count;
  double *slots = g->slots;
  const int64_t padded = (int64_t)g->blocks * own;
  for (int k = 0; k < g->operations; k++) {
    const int32_t *row = g->rows[k];
    double *restrict y = SLOT(row[4]);
    const double *a = SLOT(row[1]), *b = SLOT(row[2]), *c = SLOT(row[3]);
    switch (row[0]) {
    case GATHER: {
      const gather *s = g->gathers + row[1];
      const double *table = tables + s->table * padded + block * LANES;
      if (s->source == 2) {
        EACH y[p] = table[p % own];
        break;
      }
      const double *values = (s->source ? nodes : w) + s->offset;
      if (cells.count > 1) {
        for (int n = 0; n < cells.count; n++, values += s->source ? cells.x : cells.w)
          for (int p = 0; p < own; p++) {
            double sum = 0;
            for (int i = 0; i < s->count; i++) sum += values[(int64_t)i * s->stride] * table[i * padded + p];
            y[n * own + p] = sum;
          }
        break;
      }
      double sum[LANES];
      EACH sum[p] = 0;
      for (int i = 0; i < s->count; i++, table += padded) {
        const double value = values[(int64_t)i * s->stride];
        EACH sum[p] += value * table[p];
      }
      EACH y[p] = sum[p];
      break;
    }
    case CONSTANT: EACH y[p] = constants[row[1]]; break;
    case NUMBER: EACH y[p] = g->numbers[row[1]]; break;
    case ADD: EACH y[p] = a[p] + b[p]; break;
    case SUBTRACT: EACH y[p] = a[p] - b[p]; break;
    case MULTIPLY: EACH y[p] = a[p] * b[p]; break;
    case DIVIDE: EACH y[p] = a[p] / b[p]; break;
    case MULTIPLY_ADD: EACH y[p] = a[p] * b[p] + c[p]; break;
    case SUBTRACT_PRODUCT: EACH y[p] = c[p] - a[p] * b[p]; break;
    case SCALE: { const double x = g->numbers[row[2]]; EACH y[p] = x * a[p]; break; }
    case SHIFT: { const double x = g->numbers[row[2]]; EACH y[p] = x + a[p]; break; }
    case NEGATE: EACH y[p] = -a[p]; break;
    case LESS: EACH y[p] = a[p] < b[p]; break;
    case LESS_EQUAL: EACH y[p] = a[p] <= b[p]; break;
    case EQUAL: EACH y[p] = a[p] == b[p]; break;
    case SELECT: EACH y[p] = a[p] != 0 ? b[p] : c[p]; break;
    case SIGN: EACH y[p] = (a[p] > 0) - (a[p] < 0); break;
    case POWER: EACH y[p] = pow(a[p], b[p]); break;
    MAPPED(ABSOLUTE, fabs) MAPPED(SQRT, sqrt) MAPPED(EXP, exp) MAPPED(LN, log) MAPPED(SIN, sin) MAPPED(COS, cos)
    MAPPED(TAN, tan) MAPPED(SINH, sinh) MAPPED(COSH, cosh) MAPPED(TANH, tanh) MAPPED(ASIN, asin) MAPPED(ACOS, acos)
    MAPPED(ATAN, atan) MAPPED(ERF, erf)
    }
  }
}

/* Add the outputs of a block of points to the values of an expression, or to an element's number, vector or matrix. */
static inline __attribute__((always_inline)) void add(const int LANES, const program *g, int block, together cells,
                                                      double *A, const double *tables) {
  const double *slots = g->slots;
  const int64_t padded = (int64_t)g->blocks * LANES;
  for (int o = 0; o < g->outputs; o++) {
    const double *v = SLOT(g->results[o].slot);
    if (g->rank < 0) {
      for (int n = 0, own = LANES / cells.count; n < cells.count; n++)
        for (int p = 0; p < own && block * own + p < g->points; p++)
          A[n * cells.A + ((int64_t)block * own + p) * g->width + g->results[o].row] = v[n * own + p];
      continue;
    }
    if (g->rank == 0) {
      double sum = 0;
      EACH sum += v[p];
      A[0] += sum;
      continue;
    }
    const basis *row = g->bases + g->results[o].row;
    const double *table = tables + row->table * padded + block * LANES;
    if (g->rank == 1) {
      for (int i = 0; i < row->count; i++, table += padded) {
        double sum = 0;
        EACH sum += v[p] * table[p];
        A[row->offset + (int64_t)i * row->stride] += sum;
      }
      continue;
    }
    /* All outputs of a row: first the sum over their columns at each point, then one product with the row's table. */
    const int columns = (g->columns + 3) & ~3;
    double *restrict products = g->products;
    memset(products, 0, sizeof(double) * LANES * columns);
    int first = columns, last = 0;
    for (;; o++) {
      const output *r = g->results + o;
      const basis *column = g->bases + r->column;
      const double *moduli = SLOT(r->slot), *functions = tables + column->table * padded + block * LANES;
      for (int j = 0; j < column->count; j++, functions += padded)
        EACH products[p * columns + column->offset + j] += moduli[p] * functions[p];
      if (column->offset < first) first = column->offset & ~3;
      if (column->offset + column->count > last) last = column->offset + column->count;
      if (o + 1 == g->outputs || r[1].row != r->row) break;
    }
    for (int i = 0; i < row->count; i++, table += padded) {
      double *target = A + (row->offset + (int64_t)i * row->stride) * g->columns;
      for (int j = first; j < last; j += 4) {
        double sum[4] = {0, 0, 0, 0};
        EACH for (int n = 0; n < 4; n++) sum[n] += table[p] * products[p * columns + j + n];
        for (int n = 0; n < 4 && j + n < g->columns; n++) target[g->places[j + n]] += sum[n];
      }
    }
  }
}

static inline __attribute__((always_inline)) void blocks(const int LANES, const program *g, together cells, double *A,
                                                         const double *w, const double *c, const double *x,
                                                         const double *tables) {
  for (int block = 0; block < g->blocks; block++) {
    run(LANES, g, block, cells, w, c, x, tables);
    add(LANES, g, block, cells, A, tables);
  }
}

static const together ONE = {1, 0, 0, 0};

static void __attribute__((noinline)) blocks_of_16(const program *g, together cells, double *A, const double *w,
                                                   const double *c, const double *x, const double *tables) {
  blocks(16, g, cells, A, w, c, x, tables);
}

static void __attribute__((noinline)) tabulate(const kernel *k, double *A, const double *w, const double *c,
                                               const double *x, const int *entity) {
  for (const program *g = k->programs; g < k->programs + k->count; g++) {
    const double *tables = g->tables + (g->entity_size ? g->entity_size * *entity : 0);
    if (g->lanes == 4) blocks(4, g, ONE, A, w, c, x, tables);
    else if (g->lanes == 8) blocks(8, g, ONE, A, w, c, x, tables);
    else blocks_of_16(g, ONE, A, w, c, x, tables);
  }
}

/* Values of an expression on cells, whose nodal values, coordinates and results follow each other. */
void values_of_cells(const kernel *k, int64_t count, together cells, const double *w, const double *c, const double *x,
                     double *A) {
  const program *g = k->programs;
  const int most = g->blocks == 1 ? 16 / g->lanes : 1;
  for (int64_t n = 0; n < count; n += cells.count, w += cells.count * cells.w, x += cells.count * cells.x) {
    cells.count = count - n >= most ? most : 1;
    if (cells.count > 1) blocks_of_16(g, cells, A + n * cells.A, w, c, x, g->tables);
    else tabulate(k, A + n * cells.A, w, c, x, 0);
  }
}

/* Functions with the signature of a kernel, each of which runs the kernel of its number: DOLFINx gives them no data. */
#define FUNCTION(i)                                                                                                   \
  static void f##i(double *A, const double *w, const double *c, const double *x, const int *e, const uint8_t *q,      \
                   void *d) {                                                                                         \
    (void)q, (void)d;                                                                                                 \
    tabulate(kernels[0x##i], A, w, c, x, e);                                                                          \
  }
#define NAME(i) f##i,
#define TEN(F, i)                                                                                                     \
  F(i##0) F(i##1) F(i##2) F(i##3) F(i##4) F(i##5) F(i##6) F(i##7) F(i##8) F(i##9) F(i##a) F(i##b) F(i##c) F(i##d)     \
  F(i##e) F(i##f)
#define HUNDRED(F, i)                                                                                                 \
  TEN(F, i##0) TEN(F, i##1) TEN(F, i##2) TEN(F, i##3) TEN(F, i##4) TEN(F, i##5) TEN(F, i##6) TEN(F, i##7)             \
  TEN(F, i##8) TEN(F, i##9) TEN(F, i##a) TEN(F, i##b) TEN(F, i##c) TEN(F, i##d) TEN(F, i##e) TEN(F, i##f)
#define ALL(F) HUNDRED(F, 0) HUNDRED(F, 1) HUNDRED(F, 2) HUNDRED(F, 3)

const kernel *kernels[0x400];
ALL(FUNCTION)
void (*const functions[0x400])(double *, const double *, const double *, const double *, const int *, const uint8_t *,
                               void *) = {ALL(NAME)};
