# find_package(sweepd): the target sweepd::sweepd has sweepd.h, sweepd.hpp and the library libsweepd.so. Installed, all lie where
# this file's place says. In a checkout the headers lie over this folder; the library is looked for in CMAKE_PREFIX_PATH, such as
# target/release. Where there is none, the target has the headers alone: they read the bytes of sweeps.
if(NOT TARGET sweepd::sweepd)
    find_path(sweepd_INCLUDE_DIR sweepd.h NO_DEFAULT_PATH
        PATHS "${CMAKE_CURRENT_LIST_DIR}/.." "${CMAKE_CURRENT_LIST_DIR}/../../../../include")
    set(_sweepd_folders "${CMAKE_CURRENT_LIST_DIR}/../..")
    foreach(_sweepd_prefix IN LISTS CMAKE_PREFIX_PATH)
        # CMake takes it from the folder of the sources, and who writes it from where he is.
        get_filename_component(_sweepd_prefix "${_sweepd_prefix}" ABSOLUTE BASE_DIR "$ENV{PWD}")
        list(APPEND _sweepd_folders "${_sweepd_prefix}")
    endforeach()
    find_library(sweepd_LIBRARY sweepd PATHS ${_sweepd_folders} NO_DEFAULT_PATH)
    find_library(sweepd_LIBRARY sweepd)
    mark_as_advanced(sweepd_INCLUDE_DIR sweepd_LIBRARY)
    if(sweepd_LIBRARY)
        add_library(sweepd::sweepd SHARED IMPORTED)
        set_target_properties(sweepd::sweepd PROPERTIES IMPORTED_LOCATION "${sweepd_LIBRARY}")
    else()
        add_library(sweepd::sweepd INTERFACE IMPORTED)
    endif()
    set_target_properties(sweepd::sweepd PROPERTIES
        INTERFACE_INCLUDE_DIRECTORIES "${sweepd_INCLUDE_DIR}"
        INTERFACE_LINK_LIBRARIES m)
    unset(_sweepd_folders)
    unset(_sweepd_prefix)
endif()
