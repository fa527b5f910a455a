// Seeds of the readers beyond PLY, OBJ, STL and OFF.
#pragma once

#include <string>
#include <vector>

std::vector<std::string> GltfSeeds();
std::vector<std::string> DracoSeeds();
std::vector<std::string> ArchiveSeeds();
std::vector<std::string> ThreeMfSeeds();  // Models alone.
std::vector<std::string> MtlSeeds();
std::vector<std::string> AssimpSeeds();
