# Run by cpack when all is in place and before it is packed: the form that Debian wants of what any `cmake --install` installs.
file(GLOB_RECURSE files ${CPACK_TEMPORARY_DIRECTORY}/*)
foreach(file IN LISTS files)
  if(file MATCHES "/share/man/.*\\.[1-9]$|/share/doc/.*/changelog\\.Debian$")
    execute_process(COMMAND gzip -9nf ${file} COMMAND_ERROR_IS_FATAL ANY)
  elseif(file MATCHES "/lib[^/]*\\.so[^/]*$")  # what is a target of this project cpack has stripped
    execute_process(COMMAND strip --strip-unneeded --remove-section=.comment --remove-section=.note ${file}
                    COMMAND_ERROR_IS_FATAL ANY)
  endif()
endforeach()
