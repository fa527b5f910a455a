// Seeds of the readers beyond PLY, OBJ, STL and OFF.
#pragma once

#include <string>
#include <vector>

std::vector<std::string> GltfSeeds();
std::vector<std::string> DracoSeeds();
std::vector<std::string> ArchiveSeeds();
