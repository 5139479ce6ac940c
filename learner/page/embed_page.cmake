# Writes the C++ source of PageTemplate() (page.h): page.html with its style, scripts and reference figures inside.
#
# Usage: cmake -DFOLDER=DIR -DCHARTS=chart.min.js -DOUTPUT=FILE.cc -P embed_page.cmake
# Hexadecimal throughout: a list of CMake would lose semicolons and brackets of the scripts.
function(read_hex path out)
  file(READ ${path} hex HEX)
  set(${out} "${hex}" PARENT_SCOPE)
endfunction()
read_hex(${FOLDER}/page.html page)
foreach(part IN ITEMS page.css live.js references.json charts)
  if(part STREQUAL "charts")
    read_hex(${CHARTS} content)
  else()
    read_hex(${FOLDER}/${part} content)
  endif()
  string(HEX "{{${part}}}" marker)
  string(FIND "${page}" "${marker}" at)
  if(at EQUAL -1)
    message(FATAL_ERROR "page.html has no {{${part}}}")
  endif()
  string(REPLACE "${marker}" "${content}" page "${page}")
endforeach()
string(LENGTH "${page}" digits)
math(EXPR bytes "${digits} / 2")
string(REGEX REPLACE "(..)" "\\\\x\\1" literal "${page}")
file(WRITE ${OUTPUT} "#include \"learner/page/page.h\"

namespace craftfleet {

absl::string_view PageTemplate() { return absl::string_view(\"${literal}\", ${bytes}); }

}  // namespace craftfleet
")
