# Writes OUT, a C++ file that defines kOpenApiBytes and kOpenApiSize from the bytes of IN.
file(READ "${IN}" hex HEX)
string(REGEX REPLACE "(..)" "0x\\1," bytes "${hex}")
string(REGEX REPLACE "(0x..,0x..,0x..,0x..,0x..,0x..,0x..,0x..,)" "\\1\n" bytes "${bytes}")
file(WRITE "${OUT}" "namespace strata::server {\nextern const unsigned char kOpenApiBytes[] = {\n\
${bytes}};\nextern const unsigned long kOpenApiSize = sizeof kOpenApiBytes;\n}\n")
