// What OpenCV's archives refer to and calibd has no use for, in place of the libraries that it would bring along: TBB,
// LAPACK and, by OpenGL, a graphics driver. With those, calibd's libraries were 62 packages of Debian 12; without, they
// are 10. Results are the same: tests/unit/opencv_alone_test.py. Where a symbol is missing here, or is there twice,
// CMake has calibd take the shared libraries.

#include <cstddef>
#include <opencv2/core/utility.hpp>

// Used by matrix decompositions and products of large matrices, of which calibd has none. CV_HAL_ERROR_NOT_IMPLEMENTED
// has OpenCV do such a thing with its own code. The declarations are in OpenCV's hal_internal.hpp, which is not
// installed.
namespace {
constexpr int not_implemented = 1;
}

int lapack_LU32f(float*, std::size_t, int, float*, std::size_t, int, int*) { return not_implemented; }
int lapack_LU64f(double*, std::size_t, int, double*, std::size_t, int, int*) { return not_implemented; }
int lapack_Cholesky32f(float*, std::size_t, int, float*, std::size_t, int, bool*) { return not_implemented; }
int lapack_Cholesky64f(double*, std::size_t, int, double*, std::size_t, int, bool*) { return not_implemented; }
int lapack_SVD32f(float*, std::size_t, float*, float*, std::size_t, float*, std::size_t, int, int, int) {
  return not_implemented;
}
int lapack_SVD64f(double*, std::size_t, double*, double*, std::size_t, double*, std::size_t, int, int, int) {
  return not_implemented;
}
int lapack_QR32f(float*, std::size_t, int, int, int, float*, std::size_t, float*, int*) { return not_implemented; }
int lapack_QR64f(double*, std::size_t, int, int, int, double*, std::size_t, double*, int*) { return not_implemented; }
int lapack_gemm32f(const float*, std::size_t, const float*, std::size_t, float, const float*, std::size_t, float,
                   float*, std::size_t, int, int, int, int) {
  return not_implemented;
}
int lapack_gemm64f(const double*, std::size_t, const double*, std::size_t, double, const double*, std::size_t, double,
                   double*, std::size_t, int, int, int, int) {
  return not_implemented;
}
int lapack_gemm32fc(const float*, std::size_t, const float*, std::size_t, float, const float*, std::size_t, float,
                    float*, std::size_t, int, int, int, int) {
  return not_implemented;
}
int lapack_gemm64fc(const double*, std::size_t, const double*, std::size_t, double, const double*, std::size_t, double,
                    double*, std::size_t, int, int, int, int) {
  return not_implemented;
}

// There is no OpenGL context to share images with.
extern "C" {
void* glXGetCurrentContext() { return nullptr; }
void* glXGetCurrentDisplay() { return nullptr; }
void* glXGetProcAddressARB(const unsigned char*) { return nullptr; }
}

// Loops run on the thread that asks, as OpenCV does after setNumThreads(1).
namespace cv {

ParallelLoopBody::~ParallelLoopBody() = default;

void parallel_for_(const Range& range, const ParallelLoopBody& body, double) {
  if (!range.empty()) body(range);
}

void setNumThreads(int) {}
int getNumThreads() { return 1; }
int getThreadNum() { return 0; }
int getNumberOfCPUs() { return 1; }

}  // namespace cv
