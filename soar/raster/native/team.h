// A few threads for the length of one call, and buffers without initialisation.
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <mutex>
#include <new>
#include <thread>
#include <vector>

namespace soar {

// Threads live as long as the call: none is left to spin against the caller's own pool or to be lost in a fork.
class Team {
 public:
  explicit Team(int threads) {
    for (int i = 1; i < threads; ++i) workers_.emplace_back([this] { work(); });
  }
  ~Team() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      closing_ = true;
    }
    wake_.notify_all();
    for (auto& w : workers_) w.join();
  }
  Team(const Team&) = delete;
  Team& operator=(const Team&) = delete;

  // Calls job(0) ... job(count - 1), each once, on any thread, and returns when all are done. Which thread takes
  // which job varies; results must depend on the job's number alone.
  void run(int64_t count, const std::function<void(int64_t)>& job) {
    if (workers_.empty() || count <= 1) {
      for (int64_t i = 0; i < count; ++i) job(i);
      return;
    }
    {
      std::lock_guard<std::mutex> lock(mutex_);
      job_ = &job;
      count_ = count;
      next_ = 0;
      busy_ = workers_.size();
      ++round_;
    }
    wake_.notify_all();
    drain();
    std::unique_lock<std::mutex> lock(mutex_);
    idle_.wait(lock, [this] { return busy_ == 0; });
    if (failed_) throw std::bad_alloc();  // the only exception a job can raise
  }

 private:
  void drain() {
    try {
      for (int64_t i; (i = next_.fetch_add(1)) < count_;) (*job_)(i);
    } catch (...) {
      failed_ = true;
    }
  }
  void work() {
    uint64_t seen = 0;
    for (;;) {
      {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return closing_ || round_ != seen; });
        if (closing_) return;
        seen = round_;
      }
      drain();
      std::lock_guard<std::mutex> lock(mutex_);
      if (--busy_ == 0) idle_.notify_one();
    }
  }

  std::vector<std::thread> workers_;
  std::mutex mutex_;
  std::condition_variable wake_, idle_;
  const std::function<void(int64_t)>* job_ = nullptr;
  int64_t count_ = 0;
  std::atomic<int64_t> next_{0};
  std::atomic<bool> failed_{false};
  size_t busy_ = 0;
  uint64_t round_ = 0;
  bool closing_ = false;
};

// A growing array of plain values, 64-byte aligned. Growth drops the content; shrinking keeps the memory, so that a
// reused buffer costs no page faults.
template <class T>
class Buffer {
 public:
  Buffer() = default;
  ~Buffer() { release(); }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  T* need(size_t count) {
    if (count > capacity_) {
      release();
      const size_t wanted = count + count / 8;
      data_ = static_cast<T*>(::operator new(wanted * sizeof(T), std::align_val_t(64)));
      capacity_ = wanted;
    }
    return data_;
  }
  T* data() const { return data_; }
  T& operator[](size_t i) const { return data_[i]; }

 private:
  void release() {
    if (data_) ::operator delete(data_, std::align_val_t(64));
    data_ = nullptr;
    capacity_ = 0;
  }
  T* data_ = nullptr;
  size_t capacity_ = 0;
};

}  // namespace soar
