// A block [0, lx] x [0, ly] x [0, lz] of tetrahedra; all lengths in metres.
// Groups: volume "block"; surfaces "x0", "x1", "y0", "y1", "z0", "z1".
DefineConstant[
  lx = {1.0, Name "Parameters/lx"},
  ly = {1.0, Name "Parameters/ly"},
  lz = {1.0, Name "Parameters/lz"},
  size = {0.25, Name "Parameters/size"}
];

SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, lx, ly, lz};

Physical Volume("block") = {1};
Physical Surface("x0") = {1};
Physical Surface("x1") = {2};
Physical Surface("y0") = {3};
Physical Surface("y1") = {4};
Physical Surface("z0") = {5};
Physical Surface("z1") = {6};

Mesh.MeshSizeMin = size;
Mesh.MeshSizeMax = size;
