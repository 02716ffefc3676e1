// Workspace: typed pieces of one block of memory that the caller owns, without use of the heap.
#pragma once

#include <cstddef>
#include <type_traits>

namespace leglab::identification {

// Every mutable value of an identifier lives in its workspace. So the size is known before
// construction (by the same layout on a null block), a copy of the block is a snapshot that resumes
// bit-exactly, and identifiers of several joints are stored consecutively.
class Workspace {
 public:
  static constexpr std::size_t alignment = 16;

  Workspace() = default;
  explicit Workspace(std::byte* block) : block_(block) {}

  // Returns `count` values, set to zero, or nullptr while only measuring the size.
  template <class U>
  U* take(int count) {
    static_assert(std::is_trivially_copyable_v<U> && alignof(U) <= alignment);
    const std::size_t bytes = sizeof(U) * static_cast<std::size_t>(count);
    const std::size_t at = used_;
    used_ += (bytes + alignment - 1) / alignment * alignment;
    if (block_ == nullptr) return nullptr;
    for (std::size_t i = at; i < used_; ++i) block_[i] = std::byte{0};
    return reinterpret_cast<U*>(block_ + at);
  }

  std::size_t used() const { return used_; }
  bool measuring() const { return block_ == nullptr; }

 private:
  std::byte* block_ = nullptr;
  std::size_t used_ = 0;
};

}  // namespace leglab::identification
