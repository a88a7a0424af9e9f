# The ROS wheels' CMake targets carry include directories of the machine that built them
# (/opt/python/...). Drop those from every imported target, once all are known.
# A no-op with a normal ROS installation. Needs CMake 3.24 or newer.
function(_ros_wheels_fix_targets)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(directories MATCHES "/opt/python/")
      list(FILTER directories EXCLUDE REGEX "^/opt/python/")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${directories}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER CALL _ros_wheels_fix_targets)
