// a cube that a job may size
DefineConstant [ size = {0.5, Min 0.1, Max 1}, /* of the cells */ side = 1 ];
SetFactory("OpenCASCADE");
Box(1) = {0, 0, 0, side, side, side};
MeshSize{ PointsOf{ Volume{1}; } } = size;
