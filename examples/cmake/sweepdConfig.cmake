# find_package(sweepd): the target sweepd::sweepd has the header sweepd.h, and the mathematics that it needs.
if(NOT TARGET sweepd::sweepd)
    get_filename_component(_sweepd_prefix "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
    add_library(sweepd::sweepd INTERFACE IMPORTED)
    set_target_properties(sweepd::sweepd PROPERTIES
        INTERFACE_INCLUDE_DIRECTORIES "${_sweepd_prefix}/include"
        INTERFACE_LINK_LIBRARIES m)
    unset(_sweepd_prefix)
endif()
