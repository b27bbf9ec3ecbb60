# Read by every project() of the workspace (CMAKE_PROJECT_INCLUDE) when it is built on the ROS 2 wheels.

# The wheels' exported targets name include directories of the machine that built them, and CMake refuses
# imported targets whose directories do not exist. Drop those.
function(_deepseis_drop_foreign_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(includes ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(includes)
      list(FILTER includes EXCLUDE REGEX "^/opt/python/")
      set_property(TARGET ${target} PROPERTY INTERFACE_INCLUDE_DIRECTORIES "${includes}")
    endif()
  endforeach()
endfunction()

# A message's generated C++ is short, its headers are long: compile all messages of a target at once.
function(_deepseis_unite_message_sources)
  get_property(targets DIRECTORY PROPERTY BUILDSYSTEM_TARGETS)
  list(FILTER targets INCLUDE REGEX "__rosidl_typesupport_(cpp|fastrtps_c|fastrtps_cpp|introspection_cpp)$")
  foreach(target IN LISTS targets)
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_BATCH_SIZE 0)
  endforeach()
endfunction()

cmake_language(DEFER CALL _deepseis_drop_foreign_includes)
cmake_language(DEFER CALL _deepseis_unite_message_sources)
