# Writes OUT, a C++ file that defines NAME, the bytes of FILES (relative to FOLDER, commas between) as
# server/http/embedded_file.h declares them.
string(REPLACE "," ";" files "${FILES}")
set(arrays "")
set(rows "")
set(index 0)
foreach(file IN LISTS files)
  file(READ "${FOLDER}/${file}" hex HEX)
  file(SHA256 "${FOLDER}/${file}" digest)
  string(LENGTH "${hex}" digits)
  math(EXPR size "${digits} / 2")
  string(REGEX REPLACE "(..)" "0x\\1," bytes "${hex}")
  string(REGEX REPLACE "(0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,)" "\\1\n" bytes "${bytes}")
  string(APPEND arrays "const unsigned char kBytes${index}[] = {\n${bytes}0};\n")  # No array is empty.
  string(APPEND rows "    {\"/${file}\", kBytes${index}, ${size}, \"\\\"${digest}\\\"\"},\n")
  math(EXPR index "${index} + 1")
endforeach()
file(WRITE "${OUT}" "#include \"server/http/embedded_file.h\"\n\nnamespace strata::server {\nnamespace {\n
${arrays}\nconst EmbeddedFile kFiles[] = {\n${rows}};\n
}  // namespace\n\nconst EmbeddedFiles ${NAME} = kFiles;\n\n}  // namespace strata::server\n")
