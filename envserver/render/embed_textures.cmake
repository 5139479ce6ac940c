# Writes the C++ source of BuiltInTextures() (textures.h): every *.png of a folder, byte for byte, sorted by name.
#
# Usage: cmake -DFOLDER=DIR -DOUTPUT=FILE.cc -P embed_textures.cmake
file(GLOB files LIST_DIRECTORIES false ${FOLDER}/*.png)
list(SORT files)
list(LENGTH files count)
set(entries "")
foreach(file IN LISTS files)
  get_filename_component(name ${file} NAME)
  file(SIZE ${file} size)
  file(READ ${file} hex HEX)
  string(REGEX REPLACE "(..)" "\\\\x\\1" bytes "${hex}")
  string(APPEND entries "    {\"${name}\", absl::string_view(\"${bytes}\", ${size})},\n")
endforeach()
file(WRITE ${OUTPUT} "#include \"envserver/render/textures.h\"

namespace craftfleet {
namespace {

constexpr TextureFile kFiles[${count}] = {
${entries}};

}  // namespace

absl::Span<const TextureFile> BuiltInTextures() { return kFiles; }

}  // namespace craftfleet
")
