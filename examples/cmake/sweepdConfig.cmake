# find_package(sweepd): the target sweepd::sweepd has sweepd.h, sweepd.hpp and the library libsweepd.so. Installed, all lie where
# this file's place says. In a checkout the headers lie over this folder; the library is looked for in CMAKE_PREFIX_PATH, such as
# target/release.
if(NOT TARGET sweepd::sweepd)
    # In lib/cmake/sweepd, or in lib/MACHINE/cmake/sweepd.
    find_path(sweepd_INCLUDE_DIR sweepd.h NO_DEFAULT_PATH
        PATHS "${CMAKE_CURRENT_LIST_DIR}/.." "${CMAKE_CURRENT_LIST_DIR}/../../../include"
            "${CMAKE_CURRENT_LIST_DIR}/../../../../include")
    set(_sweepd_folders "${CMAKE_CURRENT_LIST_DIR}/../..")
    foreach(_sweepd_prefix IN LISTS CMAKE_PREFIX_PATH)
        # Who writes it means where he is, the folder of his sources, or the checkout.
        foreach(_sweepd_base "$ENV{PWD}" "${CMAKE_SOURCE_DIR}" "${CMAKE_CURRENT_LIST_DIR}/../..")
            get_filename_component(_sweepd_folder "${_sweepd_prefix}" ABSOLUTE BASE_DIR "${_sweepd_base}")
            list(APPEND _sweepd_folders "${_sweepd_folder}")
        endforeach()
    endforeach()
    find_library(sweepd_LIBRARY sweepd PATHS ${_sweepd_folders} NO_DEFAULT_PATH)
    find_library(sweepd_LIBRARY sweepd)
    mark_as_advanced(sweepd_INCLUDE_DIR sweepd_LIBRARY)
    if(sweepd_INCLUDE_DIR AND sweepd_LIBRARY)
        add_library(sweepd::sweepd SHARED IMPORTED)
        set_target_properties(sweepd::sweepd PROPERTIES
            IMPORTED_LOCATION "${sweepd_LIBRARY}"
            INTERFACE_INCLUDE_DIRECTORIES "${sweepd_INCLUDE_DIR}"
            INTERFACE_LINK_LIBRARIES m)
    else()
        set(sweepd_FOUND FALSE)
        set(sweepd_NOT_FOUND_MESSAGE "There is no libsweepd.so with sweepd.h. Install the package libsweepd-dev; or in a checkout of \
sweepd run `cargo build --release`, and give CMake the folder of the library, -DCMAKE_PREFIX_PATH=target/release.")
    endif()
    unset(_sweepd_folders)
    unset(_sweepd_folder)
    unset(_sweepd_prefix)
    unset(_sweepd_base)
endif()
