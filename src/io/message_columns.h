#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "odmc/sensing/samples.h"

namespace odmc {

/// Some fields of all messages of one topic of a log, a column each, in the order of the log.
struct MessageColumns {
  std::vector<Stamp> stamps;
  std::map<std::string, std::vector<double>> values;  ///< by field; as long as `stamps`

  size_t size() const { return stamps.size(); }
  bool Has(const std::string& field) const { return values.count(field) > 0; }
  double At(const std::string& field, size_t row) const { return values.at(field)[row]; }
};

/// Columns of several fields, to read rows with.
class FieldGroup {
 public:
  FieldGroup(const MessageColumns& table, const std::vector<std::string>& fields) {
    for (const std::string& field : fields) {
      const auto found = table.values.find(field);
      if (found == table.values.end()) {
        columns_.clear();
        return;
      }
      columns_.push_back(&found->second);
    }
  }
  bool present() const { return !columns_.empty(); }  ///< the topic has every one
  double operator()(size_t i, size_t row) const { return (*columns_[i])[row]; }
  Eigen::Vector3d Vector(size_t row) const {
    return {(*this)(0, row), (*this)(1, row), (*this)(2, row)};
  }

 private:
  std::vector<const std::vector<double>*> columns_;
};

/// NAME[0], NAME[1], ...
inline std::vector<std::string> Elements(const std::string& name, int count) {
  std::vector<std::string> fields;
  for (int i = 0; i < count; ++i) fields.push_back(name + "[" + std::to_string(i) + "]");
  return fields;
}

}  // namespace odmc
