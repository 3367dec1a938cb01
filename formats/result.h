// Errors as values, for everything that comes from outside: bytes, files, devices, user input.
// Result<T> has the member names of std::expected (C++23). FF_CHECK is for our own bugs only; no file content may reach it.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <optional>
#include <string>
#include <utility>
#include <variant>

namespace ff {

// The values are the exit codes of every tool.
enum class ErrorCode { kUsage = 1, kIo = 2, kInvalidFile = 3, kPhysics = 4 };

// What a caller may recover from by other means than the user's: a GPU that is gone or full leaves the CPU; who stopped the work knows.
enum class ErrorCause { kOther, kDeviceLost, kOutOfDeviceMemory, kStopped };

struct Error {
  ErrorCode code = ErrorCode::kIo;
  std::string file;     // as the user named it; empty: no file is involved
  std::string place;    // "offset 4096", "accessor 3", "strip 1:17"; may be empty
  std::string message;  // what is wrong
  std::string remedy;   // what to do about it; may be empty
  ErrorCause cause = ErrorCause::kOther;

  // "file: place: message; remedy", on one line.
  std::string line() const {
    std::string s = file;
    for (const std::string* part : {&place, &message}) {
      if (part->empty()) continue;
      if (!s.empty()) s += ": ";
      s += *part;
    }
    if (!remedy.empty()) s += "; " + remedy;
    for (char& c : s)
      if (c == '\n' || c == '\r') c = ' ';
    return s;
  }
};

template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : state_(std::in_place_index<0>, std::move(value)) {}
  Result(Error error) : state_(std::in_place_index<1>, std::move(error)) {}
  bool has_value() const { return state_.index() == 0; }
  explicit operator bool() const { return has_value(); }
  T& value() { return std::get<0>(state_); }
  const T& value() const { return std::get<0>(state_); }
  T& operator*() { return value(); }
  const T& operator*() const { return value(); }
  T* operator->() { return &value(); }
  const T* operator->() const { return &value(); }
  const Error& error() const { return std::get<1>(state_); }

 private:
  std::variant<T, Error> state_;
};

template <>
class [[nodiscard]] Result<void> {
 public:
  Result() = default;
  Result(Error error) : error_(std::move(error)) {}
  bool has_value() const { return !error_.has_value(); }
  explicit operator bool() const { return has_value(); }
  const Error& error() const { return *error_; }

 private:
  std::optional<Error> error_;
};

#define FF_CHECK_OP_(a, op, b)                                                                                      \
  do {                                                                                                              \
    const auto& ff_a = (a);                                                                                         \
    const auto& ff_b = (b);                                                                                         \
    if (!(ff_a op ff_b)) {                                                                                          \
      std::cerr << __FILE__ << ":" << __LINE__ << ": check failed: " #a " " #op " " #b " (" << ff_a << " vs " << ff_b \
                << ")\n";                                                                                           \
      std::abort();                                                                                                 \
    }                                                                                                               \
  } while (false)
#define FF_CHECK_EQ(a, b) FF_CHECK_OP_(a, ==, b)
#define FF_CHECK_LT(a, b) FF_CHECK_OP_(a, <, b)
#define FF_CHECK_LE(a, b) FF_CHECK_OP_(a, <=, b)

}  // namespace ff
