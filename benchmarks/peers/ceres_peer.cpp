// A rig of cameras and moving boards, solved by ceres: one block of residuals per view, derived automatically.
//
// Standard input, doubles: the numbers of cameras C, boards N and corners K; the intrinsics fx fy cx cy k1 k2 p1 p2 k3;
// corners (K, 3); pixels (C, N, K, 2); poses (C + N, 6), rotation vector and translation of T_camera_world and
// T_world_board. The first camera stays. Standard output, doubles: the seconds of ceres::Solve, and the poses.

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <chrono>
#include <cstdio>
#include <vector>

struct View {
  const double *intrinsics, *corners, *pixels;
  int count;

  template <typename T>
  bool operator()(const T *camera, const T *board, T *residuals) const {
    T C[9], B[9], R[9], t[3];  // rotations column by column
    ceres::AngleAxisToRotationMatrix(camera, C);
    ceres::AngleAxisToRotationMatrix(board, B);
    for (int row = 0; row < 3; ++row) {
      t[row] = camera[3 + row];
      for (int k = 0; k < 3; ++k) t[row] += C[row + 3 * k] * board[3 + k];
      for (int column = 0; column < 3; ++column)
        R[row + 3 * column] =
            C[row] * B[3 * column] + C[row + 3] * B[3 * column + 1] + C[row + 6] * B[3 * column + 2];
    }
    const auto [fx, fy, cx, cy, k1, k2, p1, p2, k3] = *reinterpret_cast<const double(*)[9]>(intrinsics);
    for (int i = 0; i < count; ++i) {
      const double *corner = corners + 3 * i;
      T p[3];
      for (int row = 0; row < 3; ++row)
        p[row] = t[row] + R[row] * corner[0] + R[row + 3] * corner[1] + R[row + 6] * corner[2];
      const T x = p[0] / p[2], y = p[1] / p[2], r2 = x * x + y * y;
      const T radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
      residuals[2 * i] = fx * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)) + cx - pixels[2 * i];
      residuals[2 * i + 1] = fy * (y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y)) + cy - pixels[2 * i + 1];
    }
    return true;
  }
};

int main() {
  std::vector<double> in;
  double buffer[4096];
  for (size_t n; (n = fread(buffer, sizeof(double), 4096, stdin));) in.insert(in.end(), buffer, buffer + n);
  const int cameras = in[0], boards = in[1], K = in[2];
  const double *intrinsics = &in[3], *corners = intrinsics + 9, *pixels = corners + 3 * K;
  double *poses = &in[12 + 3 * K + 2 * K * cameras * boards];

  ceres::Problem problem;
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  options.function_tolerance = 1e-8;
  options.logging_type = ceres::SILENT;
  for (int c = 0; c < cameras; ++c) {
    for (int n = 0; n < boards; ++n) {
      auto *view = new View{intrinsics, corners, pixels + 2 * K * (c * boards + n), K};
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<View, ceres::DYNAMIC, 6, 6>(view, 2 * K), nullptr,
                               poses + 6 * c, poses + 6 * (cameras + n));
    }
    options.linear_solver_ordering->AddElementToGroup(poses + 6 * c, 1);
  }
  for (int n = 0; n < boards; ++n) options.linear_solver_ordering->AddElementToGroup(poses + 6 * (cameras + n), 0);
  problem.SetParameterBlockConstant(poses);

  ceres::Solver::Summary summary;
  const auto begin = std::chrono::steady_clock::now();
  ceres::Solve(options, &problem, &summary);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  if (!summary.IsSolutionUsable()) {
    fprintf(stderr, "%s\n", summary.message.c_str());
    return 1;
  }
  fwrite(&seconds, sizeof(double), 1, stdout);
  fwrite(poses, sizeof(double), 6 * (cameras + boards), stdout);
}
