#pragma once

#include <string>

#include "odmc/model/vehicle.h"

namespace odmc {

/// Every registered effect with formula, source, validity and parameters with their priors for
/// `vehicle`.
std::string CatalogueText(const Vehicle& vehicle);

/// The same as a table of effects and one of parameters, in Markdown.
std::string CatalogueMarkdown(const Vehicle& vehicle);

}  // namespace odmc
