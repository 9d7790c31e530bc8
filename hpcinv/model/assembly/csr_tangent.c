/* Search for entries of a matrix in CSR format, and addition of element matrices to its values. */

#include <stddef.h>
#include <stdint.h>

/* Find entries by row and column. All must be there; the columns of each row are ascending. */
void find(int64_t count, const int32_t *row, const int32_t *column, const int32_t *starts, const int32_t *columns,
          int32_t *entries) {
  for (int64_t k = 0; k < count; k++) {
    int32_t low = starts[row[k]], high = starts[row[k] + 1];
    while (high - low > 1) {
      const int32_t middle = low + (high - low) / 2;
      if (columns[middle] <= column[k])
        low = middle;
      else
        high = middle;
    }
    entries[k] = low;
  }
}

/* Add a block of the element matrices of some cells.

   m, n           components of test and trial functions
   nodes, others  nodes of a cell that have these
   entries        (cells, m, n, nodes, others)
   first          (cells, nodes, others): place of the first components of two nodes
   row            (cells, nodes, others), or (cells, nodes) if not per_pair: distance from there to the next component of
                  the test function; those of the trial function are side by side */
void add(int64_t cells, int m, int n, int nodes, int others, const double *entries, const int32_t *first,
         const int32_t *row, int per_pair, double *values) {
  const size_t pairs = (size_t)nodes * others, rows = per_pair ? pairs : (size_t)nodes;
  for (; cells--; first += pairs, row += rows)
    for (int c = 0; c < m; c++)
      for (int d = 0; d < n; d++)
        for (int i = 0; i < nodes; i++)
          for (int j = 0; j < others; j++, entries++) {
            const size_t pair = (size_t)i * others + j;
            values[first[pair] + c * row[per_pair ? pair : (size_t)i] + d] += *entries;
          }
}
