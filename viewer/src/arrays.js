// Reads the arrays that hpcinv/pages/reports/packed_arrays.py writes.

async function inflated(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// One array as { rows, components, at(row, component), values }: values row by row.
export async function decoded(spec, text) {
  const content = await inflated(text);
  const { rows, components, low, span } = spec;
  const count = rows * components;
  const values = new Float32Array(count);
  for (let k = 0; k < components; k++) {
    let level = 0;
    const scale = span[k] / 65535;
    for (let i = 0; i < rows; i++) {
      const at = k * rows + i;
      level = (level + content[at] + 256 * content[count + at]) & 65535;
      values[i * components + k] = low[k] + level * scale;
    }
  }
  return { rows, components, values };
}
