# Every test has a DDS domain of its own in CALIBD_TEST_DOMAIN, so that no two programs under test ever meet; build
# folders start at different domains, so that two of them can be tested at the same time.
string(MD5 folder_hash "${CMAKE_BINARY_DIR}")
string(SUBSTRING "${folder_hash}" 0 4 folder_hash)
math(EXPR folder_domain "0x${folder_hash}" OUTPUT_FORMAT DECIMAL)
set_property(GLOBAL PROPERTY calibd_next_domain ${folder_domain})

# Labels: unit, daemon, cli, interop, scenario, lint; release-only for what sanitizers would make meaningless.
# Tests of whole programs run alone: they watch real time, and the machine may have two cores.
function(_calibd_test_properties name labels timeout)
  get_property(domain GLOBAL PROPERTY calibd_next_domain)
  math(EXPR next "${domain} + 1")
  set_property(GLOBAL PROPERTY calibd_next_domain ${next})
  math(EXPR domain "${domain} % 100 + 1")

  set(slowdown 1)
  if(CALIBD_SANITIZE)
    set(slowdown 3)
  endif()
  math(EXPR timeout "${timeout} * ${slowdown}")
  set(environment CALIBD_TEST_DOMAIN=${domain} CALIBD_TEST_SLOWDOWN=${slowdown} CALIBD_BIN_DIR=${CMAKE_BINARY_DIR}/bin
      CALIBD_SOURCE_DIR=${PROJECT_SOURCE_DIR} UBSAN_OPTIONS=print_stacktrace=1 ${ARGN})
  # CALIB_KITTI_DRIVE comes from the environment ctest runs in. What may take long starts first (COST), so that no
  # processor waits for it at the end.
  set_tests_properties(${name} PROPERTIES LABELS "${labels}" TIMEOUT ${timeout} COST ${timeout} SKIP_RETURN_CODE 77
                       ENVIRONMENT "${environment}")
  foreach(label IN LISTS labels)
    if(label MATCHES "^(daemon|interop|scenario)$")
      set_tests_properties(${name} PROPERTIES RUN_SERIAL ON)
    endif()
  endforeach()
endfunction()

# calibd_test_room(libcalib): the tests that follow are in the program libcalib_tests.
macro(calibd_test_room room)
  set(calibd_test_program ${room}_tests)
endmacro()

# calibd_add_test(NAME foo_test SOURCES unit/foo_test.cpp LIBS calib [LABELS daemon ...] [TIMEOUT seconds] [OWN_PROGRAM])
# Test cases with Catch2, in the program of the room, or in one of their own. Each test is a run of that program with the
# cases of its sources, which Catch2 selects by the file's name (-#). The label is `unit` unless others are given.
# Sanitizers skip cases tagged [release-only], those that go through the same code more often for the sake of numbers;
# sources of tests with that label are not even compiled for them.
function(calibd_add_test)
  cmake_parse_arguments(PARSE_ARGV 0 arg "OWN_PROGRAM" "NAME;TIMEOUT" "SOURCES;LIBS;LABELS")
  if(arg_UNPARSED_ARGUMENTS OR NOT arg_NAME OR NOT arg_SOURCES)
    message(FATAL_ERROR "calibd_add_test: NAME and SOURCES are needed; not understood: '${arg_UNPARSED_ARGUMENTS}'")
  endif()
  if(NOT arg_LABELS)
    set(arg_LABELS unit)
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  if(CALIBD_SANITIZE AND "release-only" IN_LIST arg_LABELS)
    return()
  endif()
  set(program ${calibd_test_program})
  if(arg_OWN_PROGRAM)
    set(program ${arg_NAME})
  endif()
  if(NOT TARGET ${program})
    add_executable(${program})
    target_link_libraries(${program} PRIVATE test_support calibd_options)
  endif()
  target_sources(${program} PRIVATE ${arg_SOURCES})
  target_link_libraries(${program} PRIVATE ${arg_LIBS})

  set(cases)
  foreach(source IN LISTS arg_SOURCES)
    get_filename_component(file ${source} NAME_WE)
    set(of_file "[#${file}]")
    if(CALIBD_SANITIZE)
      string(APPEND of_file "~[release-only]")
    endif()
    list(APPEND cases "${of_file}")
  endforeach()
  list(JOIN cases "," cases)
  add_test(NAME ${arg_NAME} COMMAND ${program} --filenames-as-tags "${cases}")
  _calibd_test_properties(${arg_NAME} "${arg_LABELS}" ${arg_TIMEOUT})
endfunction()

# calibd_add_python_test(NAME foo FILE cli/foo_test.py [LABELS cli ...] [TIMEOUT seconds])
# Runs pytest from the virtual environment that tools/setup made. The label is the file's folder unless others are given.
function(calibd_add_python_test)
  cmake_parse_arguments(PARSE_ARGV 0 arg "" "NAME;FILE;TIMEOUT" "LABELS")
  if(arg_UNPARSED_ARGUMENTS OR NOT arg_NAME OR NOT arg_FILE)
    message(FATAL_ERROR "calibd_add_python_test: NAME and FILE are needed; not understood: '${arg_UNPARSED_ARGUMENTS}'")
  endif()
  if(NOT arg_LABELS)
    get_filename_component(arg_LABELS "${arg_FILE}" DIRECTORY)
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  add_test(NAME ${arg_NAME} WORKING_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR}
           COMMAND ${PROJECT_SOURCE_DIR}/.venv/bin/python -m pytest -p no:cacheprovider -q -rf ${arg_FILE})
  _calibd_test_properties(${arg_NAME} "${arg_LABELS}" ${arg_TIMEOUT} PYTHONDONTWRITEBYTECODE=1)
endfunction()
