{error}
@failed = internal constant [{failed_length} x i8] c"{failed}\00"
@elsewhere = internal constant [{elsewhere_length} x i8] c"{elsewhere}\00"
define ptr @{name}(ptr %frame) {{
entry:
  %asked = alloca {{ i64, ptr, ptr, ptr }}
  %context_place = alloca ptr
  %samples_place = alloca i64
  %given = alloca [{count} x ptr]
{sizes}
  %last = sub i64 %rank, 1
  %size_place = getelementptr i64, ptr %sizes, i64 %last
  %samples = load i64, ptr %size_place
  %some = icmp sgt i64 %samples, 0
  br i1 %some, label %ask, label %done
ask:
  %ctx_place = getelementptr i8, ptr %frame, i64 24
  %ctx = load ptr, ptr %ctx_place
  %filled = insertvalue {{ i64, ptr, ptr, ptr }} {{ i64 32, ptr null, ptr null, ptr null }},
    ptr %ctx, 2
  store {{ i64, ptr, ptr, ptr }} %filled, ptr %asked
  %interface_place = getelementptr i8, ptr %frame, i64 16
  %interface = load ptr, ptr %interface_place
  %get_place = getelementptr i8, ptr %interface, i64 80
  %get = load ptr, ptr %get_place
  %error = call ptr %get(ptr %asked)
  %heard = icmp eq ptr %error, null
  br i1 %heard, label %find, label %passed_on
passed_on:
  ret ptr %error
find:
  %stream_place = getelementptr i8, ptr %asked, i64 24
  %stream = load ptr, ptr %stream_place
  %context_of = inttoptr i64 {context_of} to ptr
  %said = call i32 %context_of(ptr %stream, ptr %context_place)
  %told = icmp eq i32 %said, 0
  br i1 %told, label %choose, label %wrong
choose:
  %context = load i64, ptr %context_place
{functions}
  %there = icmp ne i64 %function.{devices}, 0
  br i1 %there, label %start, label %strange
start:
  store i64 %samples, ptr %samples_place
  store ptr %samples_place, ptr %given
{parameters}
  %filling = add i64 %samples, {before}
  %blocks = udiv i64 %filling, {block}
  %grid = trunc i64 %blocks to i32
  %function = inttoptr i64 %function.{devices} to ptr
  %launch = inttoptr i64 {launch} to ptr
  %code = call i32 %launch(ptr %function, i32 %grid, i32 1, i32 1, i32 {block}, i32 1, i32 1,
    i32 0, ptr %stream, ptr %given, ptr null)
  %launched = icmp eq i32 %code, 0
  br i1 %launched, label %done, label %wrong
done:
  ret ptr null
wrong:
  %of_driver = call ptr @error(ptr %frame, ptr @failed)
  ret ptr %of_driver
strange:
  %of_device = call ptr @error(ptr %frame, ptr @elsewhere)
  ret ptr %of_device
}}
