#include "symbolic.h"

#include <cmath>
#include <unordered_map>

#include "malformed.h"

namespace tt3d::model {
namespace {

using c10::IValue;
using Values = std::vector<IValue>;

const IValue& argument(const Values& values, size_t index) {
  if (index >= values.size()) throw Malformed("too few arguments");
  return values[index];
}

bool is_integer(const IValue& value) { return value.isInt() || value.isBool(); }

int64_t integer(const IValue& value) {
  if (value.isInt()) return value.toInt();
  if (value.isBool()) return value.toBool() ? 1 : 0;
  throw Malformed("expected an integer");
}

double real(const IValue& value) {
  return value.isDouble() ? value.toDouble() : static_cast<double>(integer(value));
}

bool both_integers(const Values& v) {
  return is_integer(argument(v, 0)) && is_integer(argument(v, 1));
}

int64_t checked(bool overflow, int64_t result) {
  if (overflow) throw Malformed("integer overflow");
  return result;
}

/// Rounds towards minus infinity, as in Python.
int64_t floor_divide(int64_t a, int64_t b) {
  if (b == 0 || (a == INT64_MIN && b == -1)) throw Malformed("division by zero or overflow");
  const int64_t quotient = a / b;
  return quotient - ((a % b != 0 && (a < 0) != (b < 0)) ? 1 : 0);
}

int64_t to_integer(double value) {
  if (!(std::abs(value) < 9e18)) throw Malformed("number too large for an integer");
  return static_cast<int64_t>(value);
}

IValue add(const Values& v) {
  if (!both_integers(v)) return real(v[0]) + real(v[1]);
  int64_t result = 0;
  const bool overflow = __builtin_add_overflow(integer(v[0]), integer(v[1]), &result);
  return checked(overflow, result);
}

IValue subtract(const Values& v) {
  if (!both_integers(v)) return real(v[0]) - real(v[1]);
  int64_t result = 0;
  const bool overflow = __builtin_sub_overflow(integer(v[0]), integer(v[1]), &result);
  return checked(overflow, result);
}

IValue multiply(const Values& v) {
  if (!both_integers(v)) return real(v[0]) * real(v[1]);
  int64_t result = 0;
  const bool overflow = __builtin_mul_overflow(integer(v[0]), integer(v[1]), &result);
  return checked(overflow, result);
}

IValue floordiv(const Values& v) {
  if (!both_integers(v)) return std::floor(real(v[0]) / real(v[1]));
  return floor_divide(integer(v[0]), integer(v[1]));
}

IValue modulo(const Values& v) {
  if (!both_integers(v)) return real(v[0]) - std::floor(real(v[0]) / real(v[1])) * real(v[1]);
  const int64_t a = integer(v[0]), b = integer(v[1]);
  return a - floor_divide(a, b) * b;
}

IValue true_divide(const Values& v) { return real(argument(v, 0)) / real(argument(v, 1)); }

IValue power(const Values& v) {
  const double result = std::pow(real(argument(v, 0)), real(argument(v, 1)));
  if (!both_integers(v) || integer(v[1]) < 0) return result;
  if (std::abs(result) > 9007199254740992.0) throw Malformed("integer overflow");
  return to_integer(result);
}

IValue negate(const Values& v) {
  if (!is_integer(argument(v, 0))) return -real(v[0]);
  return subtract({IValue(int64_t{0}), v[0]});
}

IValue identity(const Values& v) { return argument(v, 0); }
IValue to_real(const Values& v) { return real(argument(v, 0)); }
IValue square_root(const Values& v) { return std::sqrt(real(argument(v, 0))); }

template <double (*Round)(double)>
IValue rounded(const Values& v) {
  if (is_integer(argument(v, 0))) return integer(v[0]);
  return to_integer(Round(v[0].toDouble()));
}

template <typename Compare>
IValue compare(const Values& v) {
  if (both_integers(v)) return Compare{}(integer(v[0]), integer(v[1]));
  return Compare{}(real(v[0]), real(v[1]));
}

IValue smaller(const Values& v) { return compare<std::less<>>(v).toBool() ? v[0] : v[1]; }
IValue larger(const Values& v) { return compare<std::less<>>(v).toBool() ? v[1] : v[0]; }
IValue logical_and(const Values& v) {
  return integer(argument(v, 0)) != 0 && integer(argument(v, 1)) != 0;
}
IValue logical_or(const Values& v) {
  return integer(argument(v, 0)) != 0 || integer(argument(v, 1)) != 0;
}
IValue logical_not(const Values& v) { return integer(argument(v, 0)) == 0; }
IValue choose(const Values& v) {
  return integer(argument(v, 0)) != 0 ? argument(v, 1) : argument(v, 2);
}

}  // namespace

SymbolicFunction find_symbolic(const std::string& target) {
  static const std::unordered_map<std::string, SymbolicFunction> table = {
      {"_operator.add", add},
      {"_operator.sub", subtract},
      {"_operator.mul", multiply},
      {"_operator.floordiv", floordiv},
      {"_operator.truediv", true_divide},
      {"_operator.mod", modulo},
      {"_operator.pow", power},
      {"_operator.neg", negate},
      {"_operator.pos", identity},
      {"_operator.eq", compare<std::equal_to<>>},
      {"_operator.ne", compare<std::not_equal_to<>>},
      {"_operator.lt", compare<std::less<>>},
      {"_operator.le", compare<std::less_equal<>>},
      {"_operator.gt", compare<std::greater<>>},
      {"_operator.ge", compare<std::greater_equal<>>},
      {"_operator.and_", logical_and},
      {"_operator.or_", logical_or},
      {"math.trunc", rounded<std::trunc>},
      {"math.ceil", rounded<std::ceil>},
      {"math.floor", rounded<std::floor>},
      {"torch.sym_int", rounded<std::trunc>},
      {"torch.sym_float", to_real},
      {"torch.sym_sqrt", square_root},
      {"torch.sym_max", larger},
      {"torch.sym_min", smaller},
      {"torch.sym_not", logical_not},
      {"torch.sym_ite", choose}};
  const auto found = table.find(target);
  return found == table.end() ? nullptr : found->second;
}

}  // namespace tt3d::model
