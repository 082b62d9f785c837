#include <algorithm>

#include "odmc/effects/effects.h"

namespace odmc {
namespace {

/// Off-diagonal inertia about Bcm, as it stands in the matrix.          model.md 12.14, Eq. (M41)
class ProductsOfInertia final : public Effect {
 public:
  explicit ProductsOfInertia(const Vehicle& vehicle)
      : Effect(vehicle,
               {"products_of_inertia", "Products of inertia",
                "I_xy, I_xz, I_yz in I dw/dt = tau - w x I w", "model.md 12.14, Eq. (M41)",
                "needs angular acceleration on two axes"},
               {Product("xy", 0, 1, vehicle), Product("xz", 0, 2, vehicle),
                Product("yz", 1, 2, vehicle)}) {}

  bool adds_wrench() const override { return false; }
  BodyPropertyRows shaped_rows() const override { return {kRowInertia + 3, 3}; }

 private:
  static ParameterSpec Product(const std::string& name, int a, int b, const Vehicle& vehicle) {
    const double natural = std::min(vehicle.inertia_kg_m2[a], vehicle.inertia_kg_m2[b]);
    return {name, "kg m^2",      "entry " + name + " of the inertia matrix",
            0.0,  0.2 * natural, 0.1 * natural};
  }

  void DoShape(const ParameterValues& values, BodyProperties* body,
               BodyPropertyJacobian* J) const override {
    const int row[3] = {0, 0, 1}, column[3] = {1, 2, 2};
    for (int i = 0; i < 3; ++i) {
      body->I_BBcm_B(row[i], column[i]) += values[i];
      body->I_BBcm_B(column[i], row[i]) += values[i];
    }
    if (J != nullptr) J->block<3, 3>(kRowInertia + 3, 0).setIdentity();
  }
};

}  // namespace

std::unique_ptr<Effect> MakeProductsOfInertia(const Vehicle& vehicle) {
  return std::make_unique<ProductsOfInertia>(vehicle);
}

}  // namespace odmc
