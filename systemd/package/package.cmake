# `cpack -G DEB` in a build folder: the packages that operators install, each of what is installed as the component of its
# name. Headers and static libraries (component development) are in none.
set(CPACK_COMPONENTS_ALL calibd calibd-onnx calibd-tools)
if(TARGET calib-uplink)
  list(APPEND CPACK_COMPONENTS_ALL calibd-uplink)
endif()
if(NOT CALIB_WITH_ONNX)
  list(REMOVE_ITEM CPACK_COMPONENTS_ALL calibd-onnx)
endif()
set(CALIBD_MAINTAINER "calibd maintainers <calibd@packages.invalid>" CACHE STRING "Whom the packages name as maintainer")
set(CPACK_PACKAGE_CONTACT ${CALIBD_MAINTAINER})
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "")  # each package has its own
set(CPACK_PACKAGING_INSTALL_PREFIX ${CMAKE_INSTALL_PREFIX})
set(CPACK_STRIP_FILES ON)
set(CPACK_PRE_BUILD_SCRIPTS ${CMAKE_CURRENT_LIST_DIR}/finish.cmake)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_RELEASE 1)
set(CPACK_DEBIAN_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${PROJECT_BINARY_DIR}/${private_libraries})

# calibd_package(NAME SECTION DEPENDS RECOMMENDS SYNOPSIS DESCRIPTION)
function(calibd_package name section depends recommends synopsis description)
  string(TOUPPER ${name} key)
  set(CPACK_DEBIAN_${key}_PACKAGE_NAME ${name} PARENT_SCOPE)
  set(CPACK_DEBIAN_${key}_PACKAGE_SOURCE calibd PARENT_SCOPE)
  set(CPACK_DEBIAN_${key}_PACKAGE_SECTION ${section} PARENT_SCOPE)
  set(CPACK_DEBIAN_${key}_PACKAGE_DEPENDS ${depends} PARENT_SCOPE)
  set(CPACK_DEBIAN_${key}_PACKAGE_RECOMMENDS ${recommends} PARENT_SCOPE)
  set(CPACK_DEBIAN_${key}_DESCRIPTION "${synopsis}\n${description}" PARENT_SCOPE)
  foreach(file copyright changelog.Debian)
    install(FILES ${PROJECT_SOURCE_DIR}/systemd/package/${file} DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${name} COMPONENT ${name})
  endforeach()
endfunction()

set(same_version "${PROJECT_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE}")
calibd_package(calibd net "systemd" "" "watch the calibration of cameras and LiDARs"
  "calibd listens to the ROS 2 topics of a vehicle's cameras and LiDARs, notices
when a mount has moved, finds the new extrinsic by itself, and signs a record
of every decision. It needs no targets, no special drive and no ROS.
.
This package has the service, and calibctl to ask it and to verify records.")
calibd_package(calibd-onnx net "calibd (= ${same_version})" "" "depth from one camera for calibd"
  "With it calibd takes the depth of an image from a neural network, where a
vehicle has neither a stereo camera nor a depth camera.
.
This package has ONNX Runtime, where the distribution has none, and a network
for streets.")
calibd_package(calibd-tools net "calibd (= ${same_version}), python3" "calibd-onnx, python3-matplotlib"
  "evaluate and simulate cameras and LiDARs for calibd"
  "calib-eval tells how accurately and how soon calibd would find a displacement
on recordings of ROS 2, KITTI or nuScenes. calib-sim and calib-replay are a
simulated and a recorded vehicle. calib-check-model examines a depth network.")
if(TARGET calib-uplink)
  calibd_package(calibd-uplink net "calibd (= ${same_version})" "" "bring calibd's alerts to a fleet's server"
    "It sends the signed events of calibd, verdicts, decisions and troubles, to an
MQTT broker or into a file. They wait in calibd until they are acknowledged.")
endif()

set(CPACK_DEBIAN_CALIBD_PACKAGE_SUGGESTS "calibd-onnx, calibd-tools, calibd-uplink")
set(scripts ${CMAKE_CURRENT_LIST_DIR})
set(CPACK_DEBIAN_CALIBD_PACKAGE_CONTROL_EXTRA
    ${scripts}/postinst ${scripts}/prerm ${scripts}/postrm ${scripts}/conffiles)
set(CPACK_DEBIAN_CALIBD-UPLINK_PACKAGE_CONTROL_EXTRA
    ${scripts}/uplink/postinst ${scripts}/uplink/prerm ${scripts}/uplink/postrm ${scripts}/uplink/conffiles)
if(CALIB_WITH_ONNX AND NOT onnxruntime::onnxruntime_is_private)
  # It is loaded, not linked, so that nothing finds this dependency by itself.
  get_target_property(onnxruntime_library onnxruntime::onnxruntime LOCATION)
  execute_process(COMMAND dpkg-query -S ${onnxruntime_library} OUTPUT_VARIABLE onnxruntime_package ERROR_QUIET)
  if(onnxruntime_package MATCHES "^([^:]+):")
    string(APPEND CPACK_DEBIAN_CALIBD-ONNX_PACKAGE_DEPENDS ", ${CMAKE_MATCH_1}")
  endif()
endif()
include(CPack)
