# Read by odmcConfig.cmake: headers of odmc_estimation include Ceres. Who only wants messages needs none.
find_package(Ceres QUIET)
if(TARGET Ceres::ceres)
  list(APPEND odmc_LIBRARIES Ceres::ceres)
endif()
