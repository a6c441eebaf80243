#include <onnxruntime_cxx_api.h>

#include <string>

#include "support/catch.hpp"

TEST_CASE("the ONNX Runtime that is linked is the one that the headers describe, and it starts") {
  const std::string version = OrtGetApiBase()->GetVersionString();
  INFO("library version " << version << ", headers of API " << ORT_API_VERSION);
  // The API version is the minor version; a library that is older than the headers has no such table.
  REQUIRE(OrtGetApiBase()->GetApi(ORT_API_VERSION) != nullptr);
  CHECK(version.rfind("1." + std::to_string(ORT_API_VERSION) + ".", 0) == 0);
  CHECK_NOTHROW(Ort::Env(ORT_LOGGING_LEVEL_WARNING, "calibd"));
  CHECK_FALSE(Ort::GetAvailableProviders().empty());
}
